"""Where compiled kernels are kept, and when a kept kernel is used."""

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


def test_every_file_with_kernels_is_compiled_ahead():
    assert with_kernels() <= set(modules())


def test_all_sources_of_a_kernel_lie_in_its_room_and_those_below():
    graph = grimp.build_graph(*PACKAGES)
    for name in with_kernels():
        own = (ROOT / name.replace(".", "/")).with_suffix(".py")
        assert any(own in cache.files_of(room) for room in cache.ROOMS), f"{name}: its room is not in ROOMS"
        sources = cache._sources_of(own)
        for used in graph.find_upstream_modules(name):
            path = ROOT / used.replace(".", "/")
            file = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
            assert file in sources or not file.read_text().strip(), f"{name} uses {used}"


def imported(name: str, file: Path) -> Any:
    spec: Any = importlib.util.spec_from_file_location(name, file)
    made = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(made)
    return made


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
        begin.compiled.clear()  # type: ignore[attr-defined]
        monkeypatch.setattr(sys, "dont_write_bytecode", True)  # it knows edits by seconds only
        made = imported(f"laws_of_this_test.{module}", folder / f"{module}.py")
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
    files = {factor: package.folder / f"by{factor}.py" for factor in (2, 5)}
    for factor, file in files.items():
        file.write_text(f"def scaled(x):\n    return {factor} * x\n")
    package()
    places = {cache.place_of(imported("script", file).scaled, "kind") for file in files.values()}
    assert len(places - {None}) == 2


def test_without_a_folder_to_write_a_kernel_is_compiled_in_each_process(package, monkeypatch):
    (package.folder.parent / "file").touch()
    monkeypatch.setattr(cache, "CACHE_FOLDER", package.folder.parent / "file")
    assert [compiles(package), compiles(package)] == [True, True]


def test_a_closure_is_kept_nowhere():
    inner = 2.0

    def closure(x):
        return inner * x

    assert cache.place_of(closure, "kind") is None
    assert cache.place_of(compiles, "kind") != cache.place_of(compiles, "other kind")
