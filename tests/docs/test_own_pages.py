"""The packages in the guides on laws and drive families run, replay and pass the contract suites."""

import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from hil.app.new.skeleton import write_skeleton

ROOT = Path(__file__).parents[2]
BLOCK = re.compile(r"^```\{code-block\} \w+\n:caption: (.*?)\n\n(.*?)^```", re.DOTALL | re.MULTILINE)
CONTRACT = """
import pytest, sys
sys.exit(pytest.main(["-q", "-p", "no:cacheprovider", "-p", "no:randomly", "tests"]))
"""
SUCCESS = """
assert run.success, run.summary
assert run.summary["replay"]["exact"]
assert run.summary["rejected_frames"] == 0
"""


class Package:
    """A package written by `hil new KIND NAME`, installed on the path, and the code blocks of its guide by caption."""

    def __init__(self, kind: str, name: str, page: str, folder: Path) -> None:
        """Write and install the package."""
        self.blocks = dict(BLOCK.findall((ROOT / "docs/guides" / page).read_text()))
        self.files = {path.name: path for path in write_skeleton(kind, name, folder)}
        self.folder = folder / name
        self.install()

    def install(self) -> None:
        """Write the metadata that an installation leaves on the path."""
        project = tomllib.loads(self.files["pyproject.toml"].read_text())["project"]
        installed = self.folder / f"{project['name']}-{project['version']}.dist-info"
        installed.mkdir()
        metadata = f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: {project['version']}\n"
        (installed / "METADATA").write_text(metadata)
        groups = project["entry-points"].items()
        lines = [f"[{group}]\n" + "".join(f"{k} = {v}\n" for k, v in each.items()) for group, each in groups]
        (installed / "entry_points.txt").write_text("\n".join(lines))

    def run(self, code: str) -> str:
        """Run Python code with the package installed; return standard output."""
        here = os.environ | {"PYTHONPATH": f"{self.folder}{os.pathsep}{ROOT}"}
        command = [sys.executable, "-c", code]
        done = subprocess.run(command, cwd=self.folder, env=here, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout


PAGES = {"law": ("soft", "own-laws.md"), "protocol": ("cheetah", "own-drives.md")}


@pytest.fixture(scope="module", params=PAGES)
def package(request, tmp_path_factory):
    return Package(request.param, *PAGES[request.param], tmp_path_factory.mktemp("page"))


def test_example_package_of_the_guide_on_own_laws_or_drives_runs_and_replays(package):
    package.run(package.blocks["simulation"] + SUCCESS)


def test_example_package_of_the_guide_on_own_laws_or_drives_passes_the_contract_suite(package):
    assert re.search(r"^\d+ passed", package.run(CONTRACT), re.MULTILINE)
