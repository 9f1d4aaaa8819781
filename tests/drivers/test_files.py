"""Files and folders: written whole or not at all, read only if regular, private to one user."""

from __future__ import annotations

import errno
import os

import pytest

from drivers.files import own_folder, read_regular, whole_file

pytestmark = pytest.mark.skipif(not hasattr(os, "getuid"), reason="folders have no owner here")


def test_file_replacement_on_a_full_disk_leaves_the_earlier_file(tmp_path):
    path = tmp_path / "picture.png"
    path.write_text("earlier")

    def fill(temporary):
        temporary.write_text("half")
        raise OSError(errno.ENOSPC, "No space left on device")

    with pytest.raises(OSError, match="No space left") as raised, whole_file(path) as temporary:
        fill(temporary)
    assert (raised.value.errno, raised.value.filename) == (errno.ENOSPC, str(path))
    assert path.read_text() == "earlier"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("mode", [0o600, 0o664])
def test_replacing_a_file_keeps_its_permissions(tmp_path, mode):
    path = tmp_path / "run.yaml"
    path.write_text("earlier")
    path.chmod(mode)
    with whole_file(path) as temporary:
        temporary.write_text("later")
    assert (path.read_text(), path.stat().st_mode & 0o777) == ("later", mode)


def test_replacing_a_symbolic_link_replaces_its_target(tmp_path):
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


def test_a_pipe_and_a_file_beyond_the_limit_are_not_read(tmp_path):
    file, pipe = tmp_path / "a", tmp_path / "pipe"
    file.write_bytes(bytes(1000))
    os.mkfifo(pipe)
    assert read_regular(file, 1000) == read_regular(file) == bytes(1000)
    for path, most in ((file, 999), (pipe, 1000), (tmp_path, 1000)):
        with pytest.raises(OSError, match="999 bytes" if path == file else "not a regular file"):
            read_regular(path, most)


def test_runtime_folder_with_permissions_for_other_users_is_refused(tmp_path):
    folder = own_folder(tmp_path / "a" / "b")
    assert [path.stat().st_mode & 0o777 for path in (folder.parent, folder)] == [0o700, 0o700]
    folder.chmod(0o750)
    with pytest.raises(OSError, match="mode 0750"):
        own_folder(folder)
