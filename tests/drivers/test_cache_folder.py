"""Where compiled kernels are kept, what is said where that is elsewhere, and which of this project's files count."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest

from drivers.compiled import cache
from drivers.errors import RunError

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def places(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> tuple[Path, Path]:
    """The cache folder that is asked for, and the one of the temporary directory."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "home"))
    monkeypatch.setattr("tempfile.gettempdir", lambda: str(tmp_path))
    monkeypatch.setattr("os.getuid", lambda: tmp_path.stat().st_uid, raising=False)
    return tmp_path / "home" / "hexapod-hil", tmp_path / f"hexapod-hil-{tmp_path.stat().st_uid}"


def test_a_cache_that_lies_where_it_should_is_not_worth_a_word(places):
    assert (cache.cache_folder(), cache.elsewhere()) == (places[0], "")


def test_a_cache_that_cannot_be_made_where_it_should_is_said_to_lie_elsewhere_and_why(places):
    places[0].parent.touch()
    assert cache.elsewhere() == f"{places[0]}: Not a directory: what is compiled goes to {places[1]}"
    assert cache.cache_folder() == places[1]


def test_a_cache_that_others_can_write_to_is_not_used(places):
    places[0].mkdir(parents=True)
    places[0].chmod(0o777)
    assert cache.cache_folder() == places[1]
    assert cache.elsewhere().startswith(f"{places[0]}: must be a folder that belongs to user ")


def test_a_folder_is_used_that_can_be_written_and_searched_and_without_one_nothing_is_compiled(
    places, monkeypatch
):
    asked: list[tuple[Path, int]] = []
    allowed = {places[1]}

    def access(folder: Path, mode: int) -> bool:
        asked.append((folder, mode))
        return folder in allowed

    monkeypatch.setattr("os.access", access)
    assert cache.elsewhere() == f"{places[0]}: no right to write there: what is compiled goes to {places[1]}"
    assert asked == [(place, os.W_OK | os.X_OK) for place in places]
    allowed.clear()
    with pytest.raises(RunError, match="no folder for what is compiled: ") as caught:
        cache.cache_folder()
    for place in places:
        assert f"{place}: no right to write there; " in str(caught.value)


def test_where_users_have_no_numbers_the_temporary_cache_is_that_of_user_0(places, monkeypatch):
    places[0].parent.touch()
    monkeypatch.delattr("os.getuid")
    assert cache.cache_folder() == places[1].with_name("hexapod-hil-0")


@pytest.mark.parametrize(
    ("module", "file"),
    [
        ("drivers.compiled.atomics", "drivers/compiled/atomics.py"),
        ("plant_fmu", "plant_fmu/__init__.py"),
        ("drivers.compiled.no_such_module", None),
        ("tests.drivers.cia402_sheet", None),
        ("fnmatch", None),
    ],
)
def test_a_module_of_this_project_has_a_file_and_others_have_none(module, file):
    assert cache.file_of(module) == (None if file is None else ROOT / file)


@pytest.fixture
def source(tmp_path: Path) -> Path:
    path = tmp_path / "a.py"
    path.write_text("")
    return path


def test_a_source_with_an_old_date_that_was_put_there_since_this_process_began_is_not_as_imported(
    source, monkeypatch
):
    os.utime(source, ns=(1, 1))
    for later_ns, as_imported in ((0, False), (1, True)):
        monkeypatch.setattr(cache, "_BEGAN_NS", source.stat().st_ctime_ns + later_ns)
        cache.is_as_imported.cache_clear()
        assert cache.is_as_imported(source) is as_imported


def test_a_source_is_hashed_before_its_date_is_looked_at(source, monkeypatch):
    began_ns = source.stat().st_ctime_ns + 1

    def edited_first(path: Path) -> Path:
        os.utime(path, ns=(began_ns, began_ns))
        return path

    monkeypatch.setattr(cache, "_BEGAN_NS", began_ns)
    monkeypatch.setattr(cache, "folder_of", edited_first)
    cache.is_as_imported.cache_clear()
    assert not cache.is_as_imported(source)


class Counting:
    """Mutable state: what it was told."""

    def __init__(self) -> None:
        self.told: list[Any] = []

    def begin(self) -> None:
        self.told.append("compiles")

    def compiled(self, source: Path) -> None:
        self.told.append(source)


def test_who_counts_is_told_the_file_of_each_kernel_that_was_compiled_and_the_last_one_counts(monkeypatch):
    monkeypatch.setattr(cache, "_watching", [])
    cache.compiled(Path("nobody counts"))
    first, second = Counting(), Counting()
    cache.watch(first)
    cache.compiled(Path("a.py"))
    cache.watch(second)
    cache.compiled(Path("b.py"))
    assert (first.told, second.told) == ([Path("a.py")], [Path("b.py")])


def test_a_compilation_is_announced_for_a_file_of_which_no_kernel_is_kept(monkeypatch, tmp_path):
    function = test_a_compilation_is_announced_for_a_file_of_which_no_kernel_is_kept
    monkeypatch.setattr(cache, "folder_of", lambda _: tmp_path)
    monkeypatch.setattr(cache, "_watching", [])
    counting = Counting()
    cache.watch(counting)
    (tmp_path / "kept.nbi").touch()
    cache.Locator(function, "a.py")
    assert counting.told == []
    (tmp_path / "kept.nbi").unlink()
    locator = cache.Locator(function, "a.py")
    assert counting.told == ["compiles"]
    assert (locator.get_cache_path(), locator.get_source_stamp()) == (str(tmp_path), tmp_path.name)
