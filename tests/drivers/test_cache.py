"""Where compiled kernels are kept, and when a first compilation is announced."""

import ast
import importlib
import os
import re
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import pytest

from drivers.compiled import cache
from drivers.compiled.cache import cache_folder
from tools.compile_kernels import PACKAGES, modules

ROOT = Path(__file__).parents[2]
PROGRAM = """
from types import SimpleNamespace
from drivers.compiled.cache import watch
said = []
watch(SimpleNamespace(begin=lambda: said or said.append(print("announced")), compiled=lambda _: None))
import kernels_of_a_test
print(kernels_of_a_test.twice(1.0))
"""
KERNELS = """
from drivers.compiled.compiler import REAL, kernel

@kernel(REAL)
def twice(x):
    return 2.0 * x

@kernel(REAL)
def thrice(x):
    return 3.0 * x
"""


def test_the_cache_lies_under_xdg_cache_home(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert cache_folder() == tmp_path / "hexapod-hil"
    assert cache_folder().stat().st_mode & 0o777 == 0o700


def test_a_relative_xdg_cache_home_does_not_count(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", "here")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert cache_folder() == tmp_path / ".cache" / "hexapod-hil"


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="folders have no owner here")
def test_where_the_cache_cannot_be_made_it_lies_in_the_temporary_folder(monkeypatch, tmp_path):
    (tmp_path / "file").touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    monkeypatch.setattr("tempfile.gettempdir", lambda: str(tmp_path))
    assert cache_folder() == tmp_path / f"hexapod-hil-{os.getuid()}"


def test_a_compilation_is_announced_once_and_none_where_all_is_compiled(tmp_path):
    (tmp_path / "kernels_of_a_test.py").write_text(KERNELS)
    time.sleep(2 / os.sysconf("SC_CLK_TCK"))  # when a process began is known to a tick, rounded down
    environment = os.environ | {
        "XDG_CACHE_HOME": str(tmp_path),
        "PYTHONPATH": os.pathsep.join([str(tmp_path), str(Path(__file__).parents[2])]),
    }
    runs = [
        subprocess.run(
            [sys.executable, "-c", PROGRAM], env=environment, capture_output=True, text=True, check=True
        )
        for _ in range(2)
    ]
    assert [run.stdout.split() for run in runs] == [["announced", "2.0"], ["2.0"]]


def test_what_compiles_all_kernels_imports_every_file_that_has_some():
    having = re.compile(r"^@(?:kernel|direct)\(", re.MULTILINE)
    files = [file for package in PACKAGES for file in (ROOT / package).rglob("*.py")]
    names = {
        ".".join(file.relative_to(ROOT).with_suffix("").parts)
        for file in files
        if having.search(file.read_text())
    }
    assert "hil.robot.dynamics_kernels" in names
    assert names <= set(modules())


PACKAGE = "project_of_this_test"
SUM = """
from drivers.compiled.compiler import REAL, kernel
from project_of_this_test import (
    addends,
)

addend = addends.addend

@kernel(REAL)
def plus(x):
    return x + addend
"""


@pytest.fixture
def project(monkeypatch, tmp_path):
    """A package of its own, whose kernel adds what another module says, and a cache of its own."""
    folder = tmp_path / PACKAGE
    folder.mkdir()
    (folder / "__init__.py").touch()
    (folder / "addends.py").write_text("addend = 1.0")
    (folder / "sums.py").write_text(SUM)

    def file_of(module):
        path = tmp_path.joinpath(*module.split(".")).with_suffix(".py")
        return path if path.is_file() else None

    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)  # it knows edits by seconds only
    monkeypatch.setattr(cache, "CACHE_FOLDER", tmp_path / "cache")
    monkeypatch.setattr(cache, "file_of", file_of)
    monkeypatch.setattr(cache, "_watching", [])
    monkeypatch.setattr(
        cache, "_IMPORT", re.compile(cache._IMPORT.pattern.replace("hil", PACKAGE), re.MULTILINE)
    )
    return folder


def begin_anew(monkeypatch):
    """Forget what a later process would not know."""
    for name in [name for name in sys.modules if name.startswith(PACKAGE)]:
        del sys.modules[name]
    for remembered in (
        cache.imports, cache.sources_of, cache._content, cache.folder_of, cache.is_as_imported,
    ):  # fmt: skip
        remembered.cache_clear()
    importlib.invalidate_caches()
    time.sleep(0.02)  # stamps of files are up to a tick of the kernel late
    monkeypatch.setattr(cache, "_BEGAN_NS", time.time_ns())


def plus_of(module):
    """Return 0 plus what the kernel adds, and how many kernels came out of the cache."""
    kernel = importlib.import_module(f"{PACKAGE}.{module}").plus
    return kernel(0.0), sum(kernel.stats.cache_hits.values())


def test_what_was_imported_before_its_source_was_saved_is_compiled_and_not_kept(project, monkeypatch):
    begin_anew(monkeypatch)
    importlib.import_module(f"{PACKAGE}.addends")
    time.sleep(0.02)
    (project / "addends.py").write_text("addend = 2.0")
    announced = []
    cache.watch(SimpleNamespace(begin=lambda: announced.append(1), compiled=lambda _: None))
    assert plus_of("sums") == (1.0, 0)
    assert announced
    begin_anew(monkeypatch)
    assert plus_of("sums") == (2.0, 0)
    begin_anew(monkeypatch)
    assert plus_of("sums") == (2.0, 1)


def test_what_was_edited_between_two_processes_is_compiled_anew(project, monkeypatch):
    begin_anew(monkeypatch)
    assert plus_of("sums") == (1.0, 0)
    (project / "addends.py").write_text("addend = 2.0")
    begin_anew(monkeypatch)
    assert plus_of("sums") == (2.0, 0)


def test_a_source_of_the_future_is_kept(project, monkeypatch):
    """The clock was set back: what is compiled would else be so at each start."""
    year_ns = time.time_ns() + 365 * 86400 * 10**9
    os.utime(project / "addends.py", ns=(year_ns, year_ns))
    begin_anew(monkeypatch)
    assert cache.is_as_imported(project / "sums.py")
    monkeypatch.setattr(cache, "_BEGAN_NS", 0)
    cache.is_as_imported.cache_clear()
    assert not cache.is_as_imported(project / "sums.py")


def test_a_process_began_when_it_was_started_or_a_tick_of_the_clock_before():
    """No source can be read before: a beginning rounded up would take what is written then for what was read."""
    program = "from drivers.compiled.cache import _BEGAN_NS; print(_BEGAN_NS)"
    tick_ns = 10**9 // os.sysconf("SC_CLK_TCK")
    since_asked_ns = []
    for _ in range(8):  # each at another phase of the tick
        asked = time.time_ns()
        with subprocess.Popen(
            [sys.executable, "-S", "-c", program], cwd=ROOT, stdout=subprocess.PIPE
        ) as process:
            started = time.time_ns()
            said, _nothing = process.communicate()
        assert int(said) <= started
        since_asked_ns.append(int(said) - asked)
    # a break between two readings of clocks lets one process seem older
    assert max(since_asked_ns) >= -tick_ns


def imports_of(source):
    """Return the files of this project that a source imports, as Python's own parser reads it."""
    modules = set()
    for node in ast.walk(ast.parse(source.read_text())):
        if isinstance(node, ast.Import):
            modules |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            module = str(node.module)
            modules |= {module, *(f"{module}.{alias.name}" for alias in node.names)}
    places = [ROOT / module.replace(".", "/") for module in modules if module.split(".")[0] in PACKAGES]
    files = [file for place in places for file in (place.with_suffix(".py"), place / "__init__.py")]
    return {file.resolve() for file in files if file.is_file()}


def test_every_import_of_a_source_counts_as_pythons_parser_reads_it():
    for source in (file for package in PACKAGES for file in (ROOT / package).rglob("*.py")):
        assert imports_of(source) <= cache.imports(source), source


@pytest.mark.parametrize(
    "text",
    [
        "import json, hil.signals",
        "from  hil import  signals",
        "from hil import (\n    # in brackets ) or not\n    signals,\n)",
        "from hil import(signals)",
        "from hil \\\n    import \\\n    signals",
        "x = 1; from hil import signals",
        "try: import hil.signals\nexcept ImportError: pass",
        "def f():\n\tfrom hil import signals",
    ],
)
def test_an_import_counts_as_python_allows_it_to_be_written(text, tmp_path):
    source = tmp_path / "law.py"
    source.write_text(text)
    assert (ROOT / "hil" / "signals.py").resolve() in imports_of(source) <= cache.imports(source)


def test_no_source_uses_a_relative_import():
    relative = re.compile(r"^ *from \.", re.MULTILINE)
    for source in (file for package in PACKAGES for file in (ROOT / package).rglob("*.py")):
        assert not relative.search(source.read_text()), source
