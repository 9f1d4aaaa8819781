"""Setup of `.venv`: the lock files, the search for Python, and the state after a failure."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).resolve().parents[2]
LOCKS = [f"requirements{name}.lock" for name in ("", "-compiler", "-viewers", "-release")]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())


def requirements(lock: str) -> list[str]:
    """Requirements of a lock, continuation lines joined."""
    text = (ROOT / lock).read_text().replace("\\\n", " ")
    return [line for line in text.splitlines() if line and not line.startswith("#")]


@pytest.mark.parametrize("lock", LOCKS)
def test_every_requirement_in_a_lock_file_has_an_exact_version_and_hashes(lock):
    lines = requirements(lock)
    assert lines
    assert "://" not in "".join(lines)
    for line in lines:
        assert re.match(r"[a-z0-9-]+==[\w.]+ ", line), line
        assert re.search(r"--hash=sha256:[0-9a-f]{64}", line), line


def locked(lock: str) -> dict[str, set[str]]:
    """Name of a package -> its versions in a lock."""
    found: dict[str, set[str]] = {}
    for line in requirements(lock):
        name, version = line.split()[0].split("==")
        found.setdefault(canonicalize_name(name), set()).add(version)
    return found


def assert_locked(wanted: list[str], versions: dict[str, set[str]]) -> None:
    for text in wanted:
        requirement = Requirement(text)
        there = versions[canonicalize_name(requirement.name)]
        assert all(requirement.specifier.contains(version) for version in there), text


def test_every_requirement_in_pyproject_is_in_the_lock_file():
    wanted = [*PROJECT["project"]["dependencies"], *PROJECT["build-system"]["requires"]]
    for name, group in PROJECT["dependency-groups"].items():
        wanted += group if name != "release" else []
    assert_locked(wanted, locked("requirements.lock"))


def test_lock_file_of_the_release_tools_has_the_compiler_of_the_compiler_lock_file():
    tools, compiler = locked("requirements-release.lock"), locked("requirements-compiler.lock")
    assert_locked(PROJECT["dependency-groups"]["release"], tools)
    assert tools["ziglang"] == compiler["ziglang"]


def test_lock_file_of_the_viewers_has_the_versions_of_the_main_lock_file():
    viewers, installed = locked("requirements-viewers.lock"), locked("requirements.lock")
    assert_locked(PROJECT["project"]["optional-dependencies"]["viewers"], viewers)
    both = viewers.keys() & installed.keys()
    assert both >= {"numpy", "pyarrow"}
    assert {name: viewers[name] for name in both} == {name: installed[name] for name in both}


def test_python_versions_searched_by_find_python_are_those_of_requires_python():
    limits = dict(re.findall(r"(oldest|newest)=(\d+)", (ROOT / "tools/find-python").read_text()))
    required = f">=3.{limits['oldest']},<3.{int(limits['newest']) + 1}"
    assert PROJECT["project"]["requires-python"] == required


def test_setup_without_python_fails_with_the_package_to_install(tmp_path):
    shell = shutil.which("sh") or "/bin/sh"
    done = subprocess.run(
        [shell, ROOT / "tools/find-python"],
        env={"PATH": str(tmp_path)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 1
    assert "No Python 3.11 to 3.14 found" in done.stderr
    assert "apt install" in done.stderr


@pytest.mark.long
def test_failed_setup_leaves_no_partial_virtual_environment(tmp_path):
    for name in ("pyproject.toml", *LOCKS):
        shutil.copy(ROOT / name, tmp_path)
    shutil.copytree(ROOT / "tools", tmp_path / "tools")
    nowhere = {"PIP_CONFIG_FILE": os.devnull, "PIP_INDEX_URL": "http://127.0.0.1:9/", "PIP_RETRIES": "0"}
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("PIP_", "PYTHON"))}
    base = Path(sys.base_prefix) / "bin" / "python3"
    done = subprocess.run(
        [base, tmp_path / "tools/bootstrap.py"],
        env=kept | nowhere | {"PIP_NO_CACHE_DIR": "1"},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 1
    assert "the locked dependencies cannot be installed" in done.stderr
    assert not (tmp_path / ".venv").exists()
