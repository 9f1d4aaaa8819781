"""Import names of the installation that collide with another package, and `hil --version`."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
MAIN = "import sys; from hil.cli import main; main(sys.argv[1:], prog_name='hil')"


def python(folder, script, *words, first=""):
    """Run a script as an installation would, with the folder `first` before the project on the path."""
    path = os.pathsep.join([*([str(first)] if first else []), str(ROOT)])
    return subprocess.run(
        [sys.executable, "-P", "-c", script, *words],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )


@pytest.fixture(params=["drivers", "configs", "plant_fmu"])
def decoy(request, tmp_path):
    """Folder with a foreign package that has the name of one of ours."""
    package = tmp_path / "other" / request.param
    package.mkdir(parents=True)
    (package / "__init__.py").touch()
    return package


def test_hil_reports_a_foreign_package_of_its_import_names_in_one_line(decoy, tmp_path):
    done = python(tmp_path, MAIN, "check", "virtual", first=decoy.parent)
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert str(decoy) in done.stderr


def test_import_of_a_hil_name_reports_a_foreign_package_of_its_import_names(decoy, tmp_path):
    done = python(tmp_path, "from hil import Log", first=decoy.parent)
    assert f"ImportError: {decoy} hides" in done.stderr.splitlines()[-1]


def test_foreign_package_in_the_working_folder_does_not_disturb_hil(decoy):
    assert python(decoy.parent, MAIN, "--version").returncode == 0


def test_verbose_version_has_what_a_bug_report_needs(tmp_path):
    short, full = (python(tmp_path, MAIN, "--version", *more).stdout for more in ((), ("-v",)))
    facts = dict(line.split(": ", 1) for line in full.splitlines()[1:])
    assert full.startswith(short)
    assert facts["python"].split()[1] == sys.version.split()[0]
    assert facts["kernel"].startswith(os.uname().release)
    assert {"cpu", "package.numba", "scheduler", "fmu", "caches", "installed"} <= facts.keys()
