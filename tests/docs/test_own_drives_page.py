"""The family of the page on drive families runs in a simulation and passes the contract suite."""

import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs/guides/own-drives.md").read_text()
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

SAME = """
import numpy as np
from cheetah.codec import CheetahProtocol
from drivers.config import BusSettings, DriveSettings, TransmissionSettings
from drivers.mit import mit
from drivers.protocol import Frame

bus, gear = BusSettings(layout="classic"), TransmissionSettings(lead_m=0.01)
one = CheetahProtocol(bus, DriveSettings(protocol="cheetah", transmission=gear, force_limit_N=5000))
options = {"variant": "mini_cheetah"}
other = mit(
    bus, DriveSettings(protocol="mit", transmission=gear, force_limit_N=5000, options=options)
)
assert one.requests(1.0) == other.requests(1.0)
assert one.torque_limit == other.torque_limit
for seed in range(300):
    data = np.random.default_rng(seed).bytes(5)
    frame = Frame(0, bytes((1 + seed % 6,)) + data)
    assert one._heard(frame) == other._heard(frame)
"""


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """The package of the page, as an installation leaves it on the path, and the other blocks by caption."""
    folder = tmp_path_factory.mktemp("page")
    blocks: dict[str, str] = {}
    for caption, code in BLOCK.findall(PAGE):
        blocks[caption] = f"{blocks[caption]}\n\n{code}" if caption in blocks else code
    for name in [name for name in blocks if "." in name]:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(blocks.pop(name))
    project = tomllib.loads((folder / "pyproject.toml").read_text())["project"]
    installed = folder / f"{project['name']}-{project['version']}.dist-info"
    installed.mkdir()
    (installed / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: 0.1.0\n")
    lines = [
        f"[{group}]\n" + "".join(f"{name} = {value}\n" for name, value in entries.items())
        for group, entries in project["entry-points"].items()
    ]
    (installed / "entry_points.txt").write_text("\n".join(lines))
    return folder, blocks


def run(written, code):
    folder, _ = written
    here = os.environ | {"PYTHONPATH": f"{folder}{os.pathsep}{ROOT}"}
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, cwd=folder, env=here, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_the_family_of_the_page_runs_to_parked_and_replays(written):
    run(written, written[1]["simulation"] + SUCCESS)


def test_the_family_of_the_page_passes_the_contract_suite(written):
    assert re.search(r"^\d\d passed", run(written, CONTRACT), re.MULTILINE)


def test_the_family_of_the_page_speaks_as_the_variant_of_mit_does(written):
    run(written, SAME)
