"""Where compiled kernels are kept, and when what is kept is used."""

import importlib.util
import os
import re
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import grimp
import pytest

from drivers.compiled import cache
from tools.compile_kernels import PACKAGES, modules

ROOT = Path(__file__).parents[2]
PROGRAM = """
from drivers.compiled import cache
cache.progress = lambda begins: print("compiles" if begins else "compiled")
import kernels_of_a_test
print(kernels_of_a_test.twice(1.0))
"""
KERNELS = """
from drivers.compiled.compiler import REAL, kernel

@kernel(REAL)
def twice(x):
    return 2.0 * x
"""


def test_a_kernel_is_compiled_once_for_all_processes(tmp_path):
    (tmp_path / "kernels_of_a_test.py").write_text(KERNELS)
    time.sleep(0.1)  # else they count as saved meanwhile
    environment = os.environ | {
        "XDG_CACHE_HOME": str(tmp_path),
        "PYTHONPATH": os.pathsep.join([str(tmp_path), str(ROOT)]),
    }
    runs = [
        subprocess.run(
            [sys.executable, "-c", PROGRAM], env=environment, capture_output=True, text=True, check=True
        )
        for _ in range(2)
    ]
    assert [run.stdout.split() for run in runs] == [["compiles", "compiled", "2.0"], ["2.0"]]


def with_kernels() -> set[str]:
    having = re.compile(r"(^@|= )(?:kernel|pointed|helper)\(?", re.MULTILINE)
    files = [file for package in PACKAGES for file in (ROOT / package).rglob("*.py")]
    names = {
        ".".join(file.relative_to(ROOT).with_suffix("").parts)
        for file in files
        if "drivers.compiled" in (text := file.read_text()) and having.search(text)
    }
    assert "hil.robot.dynamics_kernels" in names
    return names


def test_what_compiles_all_kernels_imports_every_file_that_has_some():
    assert with_kernels() <= set(modules())


def test_all_that_a_kernel_may_use_lies_in_its_room_and_those_below():
    graph = grimp.build_graph(*PACKAGES)
    for name in with_kernels():
        own = (ROOT / name.replace(".", "/")).with_suffix(".py")
        assert any(own in cache.files_of(room) for room in cache.ROOMS), f"{name}: its room is not in ROOMS"
        sources = cache._sources_of(own)
        for used in graph.find_upstream_modules(name):
            path = ROOT / used.replace(".", "/")
            file = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
            assert file in sources or not file.read_text().strip(), f"{name} uses {used}"


@pytest.fixture
def package(monkeypatch, tmp_path):
    """A package of a user's own, and a cache of its own; each call begins as a later process does."""
    folder = tmp_path / "laws_of_this_test"
    folder.mkdir()
    for name in ("__init__", "gains", "law"):
        (folder / f"{name}.py").write_text(KERNELS)
    monkeypatch.setattr(cache, "CACHE_FOLDER", tmp_path / "cache")

    def begin(module: str = "law") -> Any:
        for remembered in (cache._sources_of, cache._content, cache._folder_of):
            remembered.cache_clear()
        time.sleep(0.1)
        monkeypatch.setattr(cache, "BEGAN_NS", time.time_ns())
        spec = importlib.util.spec_from_file_location(f"laws_of_this_test.{module}", folder / f"{module}.py")
        assert spec
        assert spec.loader
        made = importlib.util.module_from_spec(spec)
        begin.compiled.clear()  # type: ignore[attr-defined]
        monkeypatch.setattr(sys, "dont_write_bytecode", True)  # it knows edits by seconds only
        spec.loader.exec_module(made)
        assert made.twice(4.0) == 8.0
        return made

    begin.folder, begin.compiled = folder, []  # type: ignore[attr-defined]
    monkeypatch.setattr(cache, "progress", begin.compiled.append)  # type: ignore[attr-defined]
    yield begin
    for remembered in (cache._sources_of, cache._content, cache._folder_of):
        remembered.cache_clear()


def compiles(package) -> bool:
    """Tell whether the next process compiles the kernel."""
    package()
    return bool(package.compiled)


def test_a_kernel_is_found_until_a_source_of_its_package_is_edited(package):
    assert [compiles(package), compiles(package)] == [True, False]
    (package.folder / "gains.py").write_text("gain = 2.0")
    assert [compiles(package), compiles(package)] == [True, False]


def test_the_folder_beside_a_loose_file_counts_too(package):
    (package.folder / "__init__.py").unlink()
    assert [compiles(package), compiles(package)] == [True, False]
    (package.folder / "gains.py").write_text("gain = 2.0")
    assert compiles(package)


def test_a_damaged_file_is_compiled_again(package):
    package()
    (kept,) = (package.folder.parent / "cache").rglob("*.kernel")
    content = kept.read_bytes()
    middle = len(content) // 2
    flipped = (
        content[:middle] + bytes(255 - each for each in content[middle : middle + 8]) + content[middle + 8 :]
    )
    for damaged in (b"", content[:1000], b"no pickle at all", flipped):
        kept.write_bytes(damaged)
        assert compiles(package)
        assert not compiles(package)
    assert not [each for each in kept.parent.iterdir() if each != kept]


def test_functions_that_differ_by_their_file_alone_are_kept_apart(package):
    """As of two scripts, both `__main__`, with one function on the same line."""
    names, places = ("one", "other"), set()
    for name, factor in zip(names, (2.0, 5.0), strict=True):
        (package.folder / f"{name}.py").write_text(f"def scaled(x):\n    return {factor} * x\n")
    package()
    for name in names:
        spec = importlib.util.spec_from_file_location("script", package.folder / f"{name}.py")
        assert spec
        assert spec.loader
        made = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(made)
        places.add(cache.place_of(made.scaled, "kind"))
    assert len(places) == 2
    assert None not in places


def test_what_cannot_be_written_is_compiled_for_the_process_alone(package, monkeypatch):
    (package.folder.parent / "file").touch()
    monkeypatch.setattr(cache, "CACHE_FOLDER", package.folder.parent / "file")
    assert [compiles(package), compiles(package)] == [True, True]


def test_what_was_read_before_its_source_was_saved_is_neither_found_nor_kept(package):
    package()
    module = package()
    place = cache.place_of(module.twice.py_func, "kind")
    assert place is not None
    assert cache.is_as_read(package.folder / "law.py")
    (package.folder / "gains.py").write_text("gain = 2.0")
    assert not cache.is_as_read(package.folder / "law.py")
    cache._folder_of.cache_clear()
    assert cache.place_of(module.twice.py_func, "kind") is None


def test_a_source_of_the_future_is_kept(package, monkeypatch):
    """The clock was set back: what is compiled would else be so at each start."""
    source = package.folder / "law.py"
    package()
    monkeypatch.setattr(cache, "BEGAN_NS", 0)
    assert not cache.is_as_read(source)
    stamps = [each.stat().st_ctime_ns for each in cache._sources_of(source)]
    monkeypatch.setattr(time, "time_ns", lambda: min(stamps) - 1)
    assert cache.is_as_read(source)


def test_a_function_of_another_functions_variables_is_kept_nowhere():
    inner = 2.0

    def closure(x):
        return inner * x

    assert cache.place_of(closure, "kind") is None
    assert cache.place_of(compiles, "kind") != cache.place_of(compiles, "other kind")
