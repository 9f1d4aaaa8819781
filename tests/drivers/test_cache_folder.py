"""The cache folder: where it lies, and what is reported where that is elsewhere."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from drivers.cache_folder import cache_folder, elsewhere
from drivers.errors import RunError


@pytest.fixture
def places(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> tuple[Path, Path]:
    """The cache folder that is asked for, and the one of the temporary directory."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "home"))
    monkeypatch.setattr("tempfile.gettempdir", lambda: str(tmp_path))
    monkeypatch.setattr("os.getuid", lambda: tmp_path.stat().st_uid, raising=False)
    return tmp_path / "home" / "hexapod-hil", tmp_path / f"hexapod-hil-{tmp_path.stat().st_uid}"


def test_a_cache_that_lies_where_it_should_is_not_worth_a_word(places):
    assert (cache_folder(), elsewhere()) == (places[0], "")
    assert places[0].stat().st_mode & 0o777 == 0o700


def test_a_cache_that_cannot_be_made_where_it_should_is_said_to_lie_elsewhere_and_why(places):
    places[0].parent.touch()
    assert elsewhere() == f"{places[0]}: Not a directory: what is compiled goes to {places[1]}"
    assert cache_folder() == places[1]


def test_a_cache_that_others_can_write_to_is_not_used(places):
    places[0].mkdir(parents=True)
    places[0].chmod(0o777)
    assert cache_folder() == places[1]
    assert elsewhere().startswith(f"{places[0]}: must be a folder that belongs to user ")


def test_a_folder_is_used_that_can_be_written_and_searched_and_without_one_nothing_is_compiled(
    places, monkeypatch
):
    asked: list[tuple[Path, int]] = []
    allowed = {places[1]}

    def access(folder: Path, mode: int) -> bool:
        asked.append((folder, mode))
        return folder in allowed

    monkeypatch.setattr("os.access", access)
    assert elsewhere() == f"{places[0]}: no right to write there: what is compiled goes to {places[1]}"
    assert asked == [(place, os.W_OK | os.X_OK) for place in places]
    allowed.clear()
    with pytest.raises(RunError, match="no folder for what is compiled: ") as caught:
        cache_folder()
    for place in places:
        assert f"{place}: no right to write there; " in str(caught.value)


def test_where_users_have_no_numbers_the_temporary_cache_is_that_of_user_0(places, monkeypatch):
    places[0].parent.touch()
    monkeypatch.delattr("os.getuid")
    assert cache_folder() == places[1].with_name("hexapod-hil-0")


def test_a_relative_xdg_cache_home_does_not_count(places, monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", "here")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert cache_folder() == tmp_path / ".cache" / "hexapod-hil"
