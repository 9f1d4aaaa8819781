"""The cache folder: where it lies, and that no folder is used which others can change."""

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
def test_it_lies_where_the_user_names_an_absolute_folder_else_in_the_home_folder(
    home: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, named: str | None
) -> None:
    folder = tmp_path / "named" if named == "absolute" else home / ".cache"
    if named:
        monkeypatch.setenv("XDG_CACHE_HOME", str(folder) if named == "absolute" else "here")
    assert cache_folder() == folder / "hexapod-hil"
    assert cache_folder().stat().st_mode & 0o777 == 0o700


@pytest.mark.parametrize(
    ("mode", "words"),
    [(0o777, "mode 0777: remove it"), (0o770, "mode 0770: remove it"), (None, "Not a directory")],
)
def test_a_folder_that_others_can_change_or_that_cannot_be_made_is_refused(
    home: Path, mode: int | None, words: str
) -> None:
    if mode is None:
        home.touch()
    else:
        (home / ".cache" / "hexapod-hil").mkdir(parents=True)
        (home / ".cache" / "hexapod-hil").chmod(mode)
    with pytest.raises(RunError, match=f"{words}; or set XDG_CACHE_HOME") as refused:
        cache_folder()
    assert str(home / ".cache" / "hexapod-hil") in str(refused.value)
    assert "\n" not in str(refused.value)
