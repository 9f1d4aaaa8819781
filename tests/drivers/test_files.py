"""Files and folders: written whole or not at all, read only where regular, of one user alone."""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path

import pytest

from drivers.files import made_folder, open_regular, own_folder, read_regular, whole_file

pytestmark = pytest.mark.skipif(not hasattr(os, "getuid"), reason="folders have no owner here")


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


@pytest.mark.parametrize("mode", [0o600, 0o664, 0o444])
def test_what_replaces_a_file_has_its_rights(tmp_path, mode):
    path = tmp_path / "run.yaml"
    path.write_text("earlier")
    path.chmod(mode)
    with whole_file(path) as temporary:
        temporary.write_text("later")
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


MOST = 4_194_304
"""4 MiB."""


def sized(path: Path, size: int) -> Path:
    """Return a file of so many zeros, which takes no room on the disk."""
    with path.open("wb") as file:
        file.truncate(size)
    return path


def test_four_mebibytes_are_read_whole_and_a_byte_more_is_refused_with_the_limit(tmp_path):
    assert len(read_regular(sized(tmp_path / "a", MOST))) == MOST
    with pytest.raises(OSError, match=f"more than the {MOST} bytes"):
        read_regular(sized(tmp_path / "b", MOST + 1))


@pytest.mark.parametrize("most", [0, 1, 1000])
def test_a_limit_of_its_own_takes_the_place_of_that_one(tmp_path, most):
    assert read_regular(sized(tmp_path / "a", most), most) == bytes(most)
    with pytest.raises(OSError, match=f"more than the {most} bytes"):
        read_regular(sized(tmp_path / "b", most + 1), most)


def test_a_file_is_read_as_any_other_although_a_pipe_of_its_name_would_not_have_been_waited_for(tmp_path):
    with open_regular(sized(tmp_path / "a", 3)) as file:
        assert os.get_blocking(file.fileno())
        assert file.read() == bytes(3)
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(OSError, match="not a regular file"):
        open_regular(tmp_path / "pipe")


@pytest.fixture
def lenient():
    """A umask under which a group may write into what is made."""
    before = os.umask(0o002)
    yield
    os.umask(before)


def mode(path):
    return stat.S_IMODE(path.stat().st_mode)


def test_what_is_made_is_the_users_alone_whatever_the_umask(tmp_path, lenient):
    own_folder(tmp_path / "a" / "b")
    assert [mode(tmp_path / "a"), mode(tmp_path / "a" / "b")] == [0o700, 0o700]
    (tmp_path / "plain").mkdir()
    assert mode(made_folder(tmp_path / "plain")) == 0o775  # what is there stays as its owner has it


@pytest.mark.parametrize("given", [0o770, 0o702, 0o755])
def test_a_folder_that_others_reach_is_refused_with_its_mode(tmp_path, given):
    folder = tmp_path / "a"
    folder.mkdir()
    folder.chmod(given)
    with pytest.raises(OSError, match=f"mode {given:04o}: remove it") as found:
        own_folder(folder)
    assert found.value.filename == str(folder)


def test_a_link_is_refused_even_where_its_target_is_sound(tmp_path):
    (tmp_path / "target").mkdir(mode=0o700)
    (tmp_path / "link").symlink_to(tmp_path / "target")
    with pytest.raises(OSError, match="link or no folder"):
        own_folder(tmp_path / "link")


@pytest.mark.skipif(os.getuid() != 0, reason="only root gives a folder to somebody else")
def test_another_users_folder_is_refused(tmp_path):
    (tmp_path / "a").mkdir(mode=0o700)
    os.chown(tmp_path / "a", 12345, -1)
    with pytest.raises(OSError, match="it belongs to 12345"):
        own_folder(tmp_path / "a")
