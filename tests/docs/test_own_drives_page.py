"""The family of the page on drive families runs in a simulation and passes the contract suite."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs/guides/own-drives.md").read_text()
BLOCK = re.compile(r"^```\{code-block\} python\n:caption: (.*?)\n\n(.*?)^```", re.DOTALL | re.MULTILINE)
FILES = "drivers/cheetah.py", "plant_fmu/drives/cheetah.py", "tests/drivers/test_cheetah.py"
PRELUDE = """
import sys
from pathlib import Path
import drivers, plant_fmu.drives
from drivers import row
folder = Path(sys.argv[1])
drivers.__path__.append(str(folder / "drivers"))
plant_fmu.drives.__path__.append(str(folder / "plant_fmu/drives"))
drivers.PROTOCOLS |= {%s}
plant_fmu.drives.FAMILIES |= {%s}
"""
CONTRACT = """
import pytest
sys.exit(pytest.main(["-q", "-p", "no:cacheprovider", "-p", "no:randomly", "--rootdir", sys.argv[1], sys.argv[2]]))
"""
SUCCESS = """
assert run.success, run.summary
assert run.summary["replay"]["exact"]
assert run.summary["rejected_frames"] == 0
"""

SAME = """
import numpy as np
from drivers.cheetah import CheetahProtocol
from drivers.config import BusSettings, DriveSettings, TransmissionSettings
from drivers.protocol import Frame

bus, gear = BusSettings(layout="classic"), TransmissionSettings(lead_m=0.01)
one = CheetahProtocol(bus, DriveSettings(protocol="cheetah", transmission=gear, force_limit_N=5000))
options = {"variant": "mini_cheetah"}
other = drivers.PROTOCOLS["mit"](
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
    """A folder with the files of the page, and its other blocks by caption."""
    folder = tmp_path_factory.mktemp("page")
    blocks: dict[str, str] = {}
    for caption, code in BLOCK.findall(PAGE):
        blocks[caption] = f"{blocks[caption]}\n\n{code}" if caption in blocks else code
    for name in FILES:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(blocks.pop(name))
    return folder, blocks


def run(written, code):
    folder, blocks = written
    rows = [
        next(code for caption, code in blocks.items() if name in caption)
        for name in ("PROTOCOLS", "FAMILIES")
    ]
    command = [sys.executable, "-c", PRELUDE % tuple(rows) + code, str(folder), str(folder / FILES[2])]
    here = os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run(command, cwd=folder, env=here, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_the_family_of_the_page_runs_to_parked_and_replays(written):
    run(written, written[1]["simulation"] + SUCCESS)


def test_the_family_of_the_page_passes_the_contract_suite(written):
    assert re.search(r"^\d\d passed", run(written, CONTRACT), re.MULTILINE)


def test_the_family_of_the_page_speaks_as_the_variant_of_mit_does(written):
    run(written, SAME)
