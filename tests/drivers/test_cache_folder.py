"""The cache folder: where it lies, and whose it is."""

from __future__ import annotations

from pathlib import Path

import pytest

from drivers.cache_folder import cache_folder
from drivers.errors import RunError


@pytest.fixture
def home(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """The home folder of this user."""
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    return tmp_path / "home"


@pytest.mark.parametrize("named", [None, "relative", "absolute"])
def test_it_lies_in_xdg_cache_home_where_that_is_absolute_else_at_home(
    home: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, named: str | None
) -> None:
    folder = tmp_path / "named" if named == "absolute" else home / ".cache"
    if named:
        monkeypatch.setenv("XDG_CACHE_HOME", str(folder) if named == "absolute" else "here")
    assert cache_folder() == folder / "hexapod-hil"
    assert cache_folder().stat().st_mode & 0o777 == 0o700


def test_a_folder_that_others_can_change_is_refused(home: Path) -> None:
    (home / ".cache" / "hexapod-hil").mkdir(parents=True)
    (home / ".cache" / "hexapod-hil").chmod(0o777)
    with pytest.raises(RunError, match="mode 0777"):
        cache_folder()
