"""Where compiled kernels are kept, and when a first compilation is announced."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from drivers.compiled.cache import cache_folder
from tools.compile_kernels import PACKAGES, modules

ROOT = Path(__file__).parents[2]
PROGRAM = """
from drivers.compiled.cache import before_compiling
before_compiling(lambda: print("announced"))
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
