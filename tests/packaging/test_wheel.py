"""The wheel contains all files of the product, and works outside the repository."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("configs", "drivers", "hil", "plant_fmu")


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """Build the wheel with the locked back end: no isolation, no network."""
    folder = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "hatchling", "build", "--target", "wheel", "--directory", str(folder)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    (built,) = folder.glob("*.whl")
    return built


@pytest.fixture(scope="module")
def installed(wheel, tmp_path_factory):
    """A folder with the wheel's content, which for a pure wheel is its installation."""
    target = tmp_path_factory.mktemp("target")
    with zipfile.ZipFile(wheel) as archive:
        (description,) = (name for name in archive.namelist() if name.endswith(".dist-info/WHEEL"))
        assert b"Root-Is-Purelib: true" in archive.read(description)
        archive.extractall(target)
    return target


def outside(installed, tmp_path, *arguments):
    """Run Python in a folder outside the repository, with the wheel's content first on the path.

    Compiled code comes from this suite's cache if the wheel's sources are identical.
    """
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST_")}
    environment |= {"PYTHONPATH": str(installed), "PYTHONSAFEPATH": "1"}
    return subprocess.run(
        [sys.executable, *arguments],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        timeout=240,
        check=False,
    )


def test_every_source_file_of_the_packages_is_in_the_wheel(wheel):
    with zipfile.ZipFile(wheel) as archive:
        inside = {name: archive.read(name) for name in archive.namelist()}
    kept = {
        path.relative_to(ROOT).as_posix(): path.read_bytes()
        for package in PACKAGES
        for path in (ROOT / package).rglob("*")
        if path.suffix in {".py", ".dbc", ".c", ".h", ".yaml", ".csv", ".json", ".xml", ".service"}
    }
    assert not kept.keys() - inside.keys()
    assert [name for name, content in kept.items() if inside[name] != content] == []


def test_wheel_contains_data_files_but_no_tests_and_tools(wheel):
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
    for pattern in ("*/py.typed", "drivers/legs/legs.dbc", "configs/*.yaml", "plant_fmu/stewart/sources/*.c"):
        assert [name for name in names if Path(name).match(pattern)], pattern
    tops = {name.split("/")[0] for name in names}
    assert {top for top in tops if not top.endswith(".dist-info")} == set(PACKAGES)


def test_packages_are_imported_from_the_installed_wheel(installed, tmp_path):
    script = f"import importlib, json; print(json.dumps([importlib.import_module(n).__file__ for n in {PACKAGES!r}]))"
    done = outside(installed, tmp_path, "-c", script)
    assert done.returncode == 0, done.stderr
    assert [Path(name).parent.parent for name in json.loads(done.stdout)] == [installed] * len(PACKAGES)


def test_hil_sim_runs_from_the_installed_wheel(installed, tmp_path):
    done = outside(
        installed, tmp_path, "-m", "hil.cli", "sim", "virtual", "--duration", "0.5", "--json", "sim.json"
    )
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    assert json.loads((tmp_path / "sim.json").read_text())
