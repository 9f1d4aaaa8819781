"""Cache of compiled kernels: its place, when a cached kernel is used, and detection of damage."""

from __future__ import annotations

import importlib.util
import os
import re
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import grimp
import numba
import pytest
from llvmlite import binding

from drivers.compiled import cache
from drivers.compiled.compiler import OPTIONS, REAL, kernel
from drivers.files import cache_folder
from tools.compile_kernels import PACKAGES, modules

ROOT = Path(__file__).parents[2]
PROGRAM = """
from drivers.compiled import cache
cache.progress = lambda begins: print("compiles" if begins else "compiled")
import kernels_of_a_test
print(kernels_of_a_test.twice(1.0))
"""
KERNELS = """
from drivers.compiled.compiler import REAL, helper, kernel

@helper
def positive(x):
    if x < 0.0:
        raise ValueError("negative")
    return x

@kernel(REAL)
def twice(x):
    return 2.0 * positive(x)

@kernel(REAL)
def fourfold(x):
    return twice(twice(x))
"""


def test_compiled_kernel_is_reused_from_the_cache_by_all_processes(tmp_path):
    (tmp_path / "kernels_of_a_test.py").write_text(KERNELS)
    time.sleep(0.1)  # otherwise they would count as saved meanwhile
    search = os.pathsep.join([str(tmp_path), str(ROOT)])
    environment = os.environ | {"XDG_CACHE_HOME": str(tmp_path), "PYTHONPATH": search}
    command = [sys.executable, "-c", PROGRAM]
    runs = [subprocess.check_output(command, env=environment, text=True).split() for _ in range(2)]
    assert [run[-1] for run in runs] == ["2.0", "2.0"]
    assert runs[0][:2] == ["compiles", "compiled"]
    assert len(runs[1]) == 1


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


def test_every_file_with_kernels_is_precompiled():
    assert with_kernels() <= set(modules())


def test_all_sources_that_a_kernel_depends_on_are_in_its_package_or_a_lower_layer():
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


class Package:
    """A user's package with a cache of its own. State: compilations in the last process."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, folder: Path) -> None:
        self.patch, self.folder, self.compiled = monkeypatch, folder, list[bool]()
        monkeypatch.setattr(cache, "progress", self.compiled.append)
        monkeypatch.setattr(sys, "dont_write_bytecode", True)  # it notices edits with a resolution of seconds
        for name in ("__init__", "gains", "law"):
            (folder / f"{name}.py").write_text(KERNELS)

    def forget(self) -> None:
        for remembered in (cache._sources_of, cache._content, cache._folder_of):
            remembered.cache_clear()

    def loaded(self) -> Any:
        self.forget()
        self.compiled.clear()
        time.sleep(0.1)
        self.patch.setattr(cache, "BEGAN_NS", time.time_ns())
        return imported("laws_of_this_test.law", self.folder / "law.py")

    def compiles(self) -> bool:
        assert self.loaded().twice(4.0) == 8.0
        return bool(self.compiled)


@pytest.fixture
def package(monkeypatch, tmp_path):
    (tmp_path / "laws_of_this_test").mkdir()
    monkeypatch.setattr(cache, "CACHE_FOLDER", tmp_path / "cache")
    made = Package(monkeypatch, tmp_path / "laws_of_this_test")
    yield made
    made.forget()


def test_cached_kernel_is_used_until_a_source_of_its_package_changes(package):
    assert [package.compiles(), package.compiles()] == [True, False]
    (package.folder / "gains.py").write_text("gain = 2.0")
    assert [package.compiles(), package.compiles()] == [True, False]


def test_damaged_cache_file_is_compiled_again(package):
    package.loaded()
    (kept, *_) = sorted((package.folder.parent / "cache").rglob("*.kernel"))
    content = kept.read_bytes()
    middle = len(content) // 2
    flipped = bytes(255 - each for each in content[middle : middle + 8])
    for damaged in (b"", content[:1000], b"no pickle", content[:middle] + flipped + content[middle + 8 :]):
        kept.write_bytes(damaged)
        assert [package.compiles(), package.compiles()] == [True, False]


def test_functions_that_differ_only_by_their_file_have_separate_cache_entries(package):
    """Such as two scripts, both `__main__`, with one function on the same line."""
    files = {factor: package.folder / f"by{factor}.py" for factor in (2, 5)}
    for factor, file in files.items():
        file.write_text(f"def scaled(x):\n    return {factor} * x\n")
    package.loaded()
    places = {cache.place_of(imported("script", file).scaled, "kind") for file in files.values()}
    assert len(places - {None}) == 2


def test_kernel_is_compiled_in_each_process_if_no_cache_folder_is_writable(package, monkeypatch):
    (package.folder.parent / "file").touch()
    monkeypatch.setattr(cache, "CACHE_FOLDER", package.folder.parent / "file")
    assert [package.compiles(), package.compiles()] == [True, True]


def test_kernel_loaded_from_the_cache_computes_raises_and_can_be_called_by_kernels(package, monkeypatch):
    package.loaded()
    with monkeypatch.context() as patch:
        patch.setattr(binding, "parse_bitcode", None)
        module = package.loaded()
        assert package.compiled == []
        assert (module.twice(3.0), module.fourfold(3.0)) == (6.0, 12.0)
    twice, positive = module.twice, module.positive

    @kernel(REAL)
    def own(x):
        return twice(positive(x)) + 1.0

    foreign = numba.njit("float64(float64)", **OPTIONS)(lambda x: positive(x) - 1.0)
    assert (own(2.0), foreign(2.0)) == (5.0, 1.0)
    for each in (module.fourfold, own, foreign):
        with pytest.raises(ValueError, match="negative"):
            each(-1.0)


@pytest.mark.parametrize(("given", "used"), [(None, ".cache"), ("relative", ".cache"), ("{}/own", "own")])
def test_kernel_cache_is_in_an_absolute_xdg_cache_home_or_the_home_folder(monkeypatch, tmp_path, given, used):
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    if given:
        monkeypatch.setenv("XDG_CACHE_HOME", given.format(tmp_path))
    assert cache_folder() == tmp_path / used / "hexapod-hil"
    assert cache_folder().stat().st_mode & 0o777 == 0o700
