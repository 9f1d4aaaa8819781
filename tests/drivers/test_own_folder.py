"""Folders of one user alone, and the places that use them."""

import os
import stat

import pytest

from drivers.compiled.cache import cache_folder, elsewhere
from drivers.errors import RunError
from drivers.files import made_folder, own_folder

pytestmark = pytest.mark.skipif(not hasattr(os, "getuid"), reason="folders have no owner here")


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


def test_a_cache_into_which_a_group_may_write_is_not_used_and_that_is_said(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr("tempfile.gettempdir", lambda: str(tmp_path))
    (tmp_path / "hexapod-hil").mkdir()
    (tmp_path / "hexapod-hil").chmod(0o770)
    second = tmp_path / f"hexapod-hil-{os.getuid()}"
    assert cache_folder() == second
    assert elsewhere().startswith(f"{tmp_path}/hexapod-hil: must be a folder that belongs to user")
    assert "\n" not in elsewhere()
    second.chmod(0o777)
    with pytest.raises(RunError, match="set XDG_CACHE_HOME") as found:
        cache_folder()
    assert "\n" not in str(found.value)
