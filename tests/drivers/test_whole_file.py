"""Files that are written whole or not at all: what went wrong names the file that was asked for."""

import errno
import os

import pytest

from drivers.files import whole_file


@pytest.mark.parametrize("named", [False, True])
def test_what_a_disk_refuses_names_the_file_and_leaves_the_earlier_one(tmp_path, named):
    path = tmp_path / "picture.png"
    path.write_text("earlier")

    def fill(temporary):
        temporary.write_text("half")
        raise OSError(errno.ENOSPC, "No space left on device", *([str(temporary)] if named else []))

    with pytest.raises(OSError, match="No space left") as raised, whole_file(path) as temporary:
        fill(temporary)
    assert (raised.value.errno, raised.value.filename) == (errno.ENOSPC, str(path))
    assert path.read_text() == "earlier"
    assert list(tmp_path.iterdir()) == [path]


def test_a_folder_in_which_no_file_can_be_made_is_told_by_the_file_that_was_asked_for(tmp_path):
    """Nobody knows the name of the new file beside it."""
    path = tmp_path / "gone" / "picture.png"
    with pytest.raises(FileNotFoundError) as raised, whole_file(path):
        pytest.fail("there is nothing to write into")
    assert (raised.value.errno, raised.value.filename) == (errno.ENOENT, str(path))


def test_an_error_of_another_file_keeps_its_name(tmp_path):
    with pytest.raises(FileNotFoundError) as raised, whole_file(tmp_path / "a"):
        (tmp_path / "none").read_text()
    assert raised.value.filename == str(tmp_path / "none")


def test_a_whole_file_takes_the_place_of_an_earlier_one(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("earlier")
    with whole_file(path) as temporary:
        temporary.write_text("later")
        assert path.read_text() == "earlier"
    assert path.read_text() == "later"
    assert list(tmp_path.iterdir()) == [path]


def test_while_it_is_written_a_file_is_there_for_its_owner_alone_and_then_has_the_rights_of_any_new_one(
    tmp_path,
):
    path, rights = tmp_path / "a.txt", []
    umask = os.umask(0o027)
    try:
        with whole_file(path) as temporary:
            assert list(tmp_path.iterdir()) == [temporary]
            rights.append(temporary.stat().st_mode & 0o777)
    finally:
        os.umask(umask)
    assert [*rights, path.stat().st_mode & 0o777] == [0o600, 0o640]


@pytest.mark.parametrize(("refused", "mode"), [((), 0o664), (("owner",), 0o664), (("owner", "group"), 0o604)])
def test_what_replaces_a_file_has_its_rights_and_none_for_another_group(tmp_path, monkeypatch, refused, mode):
    path = tmp_path / "run.yaml"
    path.write_text("earlier")
    path.chmod(0o664)
    there, given = path.stat(), []

    def chown(new, uid, gid):
        del new
        given.append((uid, gid))
        if ("owner" if gid == -1 else "group") in refused:
            raise PermissionError(errno.EPERM, "Operation not permitted")

    monkeypatch.setattr(os, "chown", chown)
    with whole_file(path) as temporary:
        temporary.write_text("later")
    assert given == [(there.st_uid, -1), (-1, there.st_gid)]
    assert (path.read_text(), path.stat().st_mode & 0o777) == ("later", mode)


def test_a_link_stays_one_and_what_it_leads_to_is_replaced(tmp_path):
    target, link = tmp_path / "there" / "run.yaml", tmp_path / "run.yaml"
    target.parent.mkdir()
    target.write_text("earlier")
    link.symlink_to(target)
    with whole_file(link) as temporary:
        assert temporary.parent == target.parent, "one rename, on one file system"
        temporary.write_text("later")
    assert link.is_symlink()
    assert target.read_text() == "later"
    assert sorted(each.name for each in target.parent.iterdir()) == ["run.yaml"]


def test_a_pipe_is_written_itself_and_stays_one(tmp_path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    with whole_file(pipe) as given:
        assert given == pipe
    assert pipe.is_fifo()
    assert list(tmp_path.iterdir()) == [pipe]
