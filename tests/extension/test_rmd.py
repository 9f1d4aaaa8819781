"""A drive family outside the tree, started with `hil new protocol`: MyActuator RMD."""

import re
from pathlib import Path

import pytest

from tests.docs.test_own_pages import CONTRACT, SUCCESS, Package

pytestmark = pytest.mark.long

PARTS = Path(__file__).parent / "parts" / "rmd"
VECTORS = Path(__file__).parents[1] / "data" / "drives" / "rmd.json"
SUITE = """
import numpy as np
import pytest

from drivers.config import BusSettings, DriveSettings, TransmissionSettings
from hil.contracts.trouble import TroubleContract
from rmd.codec import RmdProtocol

LEAD_m = 0.02
STEP_m, STEP_N = LEAD_m / 360, 2 * np.pi / LEAD_m * 0.01


class TestRmd(TroubleContract):
    RESOLUTION = (2 * STEP_m, 2 * STEP_m, 2 * STEP_N, 2 * STEP_N)
    LENGTHS, SPEED = (-0.06, 3.56), 1.8
    SETS_WATCHDOG = TELLS_BOOT = WATCHED = TELLS_FAULTS = False
    RESTART = "nothing"

    @pytest.fixture
    def family(self):
        drives = DriveSettings(
            protocol="rmd",
            node_ids=[1, 2, 3, 4, 5, 15],
            transmission=TransmissionSettings(lead_m=LEAD_m, offset_m=1.75, sign=[1, -1, 1, -1, 1, -1]),
            force_limit_N=9000,
        )
        return RmdProtocol(BusSettings(layout="classic"), drives)
"""
RECORDED = """
import json, struct, sys
import numpy as np
from drivers.config import BusSettings, DriveSettings, TransmissionSettings
from drivers.protocol import DriveSetup, Frame
from drivers.signals import Command, DriveMode, Reaction
from rmd.codec import RmdProtocol

drives = DriveSettings(
    protocol="rmd", node_ids=[1, 2, 3, 4, 5, 6], transmission=TransmissionSettings(lead_m=2 * np.pi), force_limit_N=300
)
family = RmdProtocol(BusSettings(layout="classic"), drives)
requests = {frame.data[0]: frame for row in (family.polls, *family.requests(1.0)) for frame in row if frame.id == 0x141}
seen = 0
for vector in json.loads(sys.argv[1]):
    data, values = bytes.fromhex(vector["data"]), vector["values"] or {}
    if vector["direction"] == "from_device":
        if data[0] != 0x9C:
            continue
        heard = family._heard(Frame(vector["id"], data))
        assert abs(heard["torque"] - values["current_A"]) < 1e-9
        assert abs(heard["turns"] * 360 - values["shaft_angle_deg"]) < 1e-9
        assert abs(heard["speed"] * 360 - values["shaft_speed_deg_s"]) < 1e-9
    elif data[0] == 0xA1:
        code = struct.unpack("<h", data[4:6])[0]
        current = values["current_A"] * (1 + 1.2e-7)  # the source has singles
        coded = family.coded(np.full(6, current))[0] / 0.01
        assert abs(coded - code) < 1e-6, (coded, code)
        assert data[:4] + data[6:] == requests[0xA1].data[:4] + requests[0xA1].data[6:]
    else:
        assert requests[data[0]].data == data
    seen += 1
print(seen)
"""
SIMULATION = """
import hil

drives = {"protocol": "rmd", "watchdog_ms": 20, "options": {"variant": None, "model": None}}
run = hil.sim("desktop", duration_s=1.0, drives=drives, loop={"rate_Hz": 200})
"""


@pytest.fixture(scope="module")
def package(tmp_path_factory):
    made = Package("protocol", "rmd", "own-drives.md", tmp_path_factory.mktemp("rmd"))
    for name in ("codec.py", "drives.py"):
        made.files[name].write_text((PARTS / name).read_text())
    made.files["test_rmd.py"].write_text(SUITE)
    return made


def test_drive_family_written_from_the_skeleton_passes_the_protocol_contract_suite(package):
    assert re.search(r"^\d\d passed", package.run(CONTRACT), re.MULTILINE)


def test_drive_family_written_from_the_skeleton_encodes_and_decodes_recorded_frames(package):
    vectors = VECTORS.read_text()
    assert int(package.run(f"import sys; sys.argv = ['', {vectors!r}]\n{RECORDED}")) == 13


def test_run_of_a_drive_family_written_from_the_skeleton_parks_and_replays(package):
    package.run(SIMULATION + SUCCESS)
