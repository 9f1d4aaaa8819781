"""Files that are written whole or not at all: what went wrong names the file that was asked for."""

import errno
import os

import pytest

from drivers.whole_file import whole_file


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
