"""Drives from a DBC: maker's bytes of MyActuator RMD, a peer library's encoding, and refused mappings."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cantools
import numpy as np
import pytest

from drivers import build_protocol
from drivers.config import BusSettings, DriveSettings, TransmissionSettings
from drivers.errors import ConfigurationError
from drivers.protocol import Frame
from drivers.signals import Command, DriveMode
from hil.contracts.trouble import TroubleContract
from tests.drivers.motor_families import GEAR, UNIT, Motors, begun, made

ROOT = Path(__file__).parents[2]
DBC = (ROOT / "docs/examples/drives/rmd.dbc").read_text("utf-8")
VECTORS = json.loads((ROOT / "tests/data/drives/dbc_rmd.json").read_text("utf-8"))["vectors"]
COMMANDS = [each for each in VECTORS if each["id"] == 321 and each["data"] != "a100000000800000"]
PEER: Any = cantools.database.load_string(DBC, "dbc")
OPTIONS: dict[str, Any] = {
    "dbc": DBC,
    "position": "Answer.Angle",
    "velocity": "Speed",
    "current": "Answer.Current",
    "command": "TorqueCurrent",
    "torque_constant_Nm_A": 2.0,
    "poll": "9c00000000000000",
    "disable": "8100000000000000",
}


def rmd(gear: Any = UNIT, **changed: Any) -> Any:
    return Motors(made("dbc", (1, 2, 3, 4, 5, 32), gear, OPTIONS | changed))


STEP = 0.1 / 360
FORCE_STEP_N = 0.02 * 2 * np.pi / 0.1


class TestRmd(TroubleContract):
    RESOLUTION = (2 * STEP, 2 * STEP, 2 * FORCE_STEP_N, 2 * FORCE_STEP_N)
    SETS_WATCHDOG = TELLS_BOOT = WATCHED = TELLS_FAULTS = False
    RESTART = "obeys"
    LENGTHS, SPEED = (1.75 - 32767 * STEP, 1.75 + 32767 * STEP), 32767 * STEP

    @pytest.fixture
    def family(self):
        return rmd(GEAR)


OTHER_DBC = """
VERSION ""
BU_: CONTROLLER DRIVE
BO_ 2147484000 Request: 6 CONTROLLER
 SG_ Kind M : 0|8@1+ (1,0) [0|0] "" DRIVE
 SG_ Torque m1 : 16|32@1- (1,0) [0|0] "N m" DRIVE
BO_ 2147484500 Answer: 8 DRIVE
 SG_ Position : 7|24@0- (0.0001,0) [0|0] "rad" CONTROLLER
 SG_ Velocity : 31|16@0- (0.01,0) [0|0] "rad/s" CONTROLLER
 SG_ Torque : 40|12@1- (0.5,0) [0|0] "Nm" CONTROLLER
 SG_ Fault : 52|4@1+ (1,0) [0|0] "" CONTROLLER
 SG_ Enabled : 56|1@1+ (1,0) [0|0] "" CONTROLLER
VAL_ 2147484500 Fault 0 "none" 1 "over current";
SIG_VALTYPE_ 2147484000 Torque : 1;
"""
OTHER_OPTIONS = {
    "dbc": OTHER_DBC,
    "position": "Position",
    "velocity": "Velocity",
    "torque": "Answer.Torque",
    "fault": "Fault",
    "enabled": "Enabled",
    "command": "Request.Torque",
    "poll": "000000000000",
    "enable": "020000000000",
    "disable": "030000000000",
    "clear": "040000000000",
}
OTHER_STEP = 0.1 * 1e-4 / (2 * np.pi)


class TestOther(TroubleContract):
    """29-bit identifiers, big-endian fields, a torque as a single, and frames and signals of the power state."""

    RESOLUTION = (2 * OTHER_STEP, 200 * OTHER_STEP, 2 * 0.5 * 2 * np.pi / 0.1, 1e-3)
    RELATIVE = 6e-8
    SETS_WATCHDOG = TELLS_BOOT = WATCHED = False
    LENGTHS = 1.75 - (2**23 - 1) * OTHER_STEP, 1.75 + (2**23 - 1) * OTHER_STEP
    SPEED = 32767 * 100 * OTHER_STEP

    @pytest.fixture
    def family(self):
        return Motors(made("dbc", (1, 2, 3, 4, 5, 32), GEAR, OTHER_OPTIONS))


@pytest.mark.parametrize("vector", [each for each in VECTORS if each["id"] == 577], ids=lambda v: v["key"])
def test_answer_of_the_maker_is_decoded_to_its_values(vector):
    heard, said = rmd().hear(Frame(577, bytes.fromhex(vector["data"]))), vector["decoded"]
    if vector["data"][:2] != "9c":
        assert heard is None
        return
    assert heard.motion == pytest.approx((said["shaft_angle_deg"] / 360, said["shaft_speed_deg_s"] / 360))
    assert heard.torque == pytest.approx(2.0 * said["current_A"])


@pytest.mark.parametrize("vector", COMMANDS, ids=lambda v: v["key"])
def test_command_of_a_current_has_the_bytes_of_the_maker(vector):
    protocol = rmd()
    current = (vector["decoded"] or vector["inputs"])["current_A"]
    force = np.full(6, 2.0 * current) * UNIT.N_per_Nm
    _, frames = protocol.command(begun(protocol), Command(DriveMode.RUN, force), 13)
    assert frames[1].data.hex() == vector["data"]
    assert [each.id for each in frames[1::2]] == [0x141, 0x142, 0x143, 0x144, 0x145, 0x160]


@pytest.mark.parametrize("angle", [-32768, -1, 0, 359, 32767])
def test_answer_encoded_by_a_peer_library_is_decoded_to_its_values(angle):
    data = PEER.encode_message(
        "Answer", {"Command": 156, "Temperature": -5, "Current": -3.5, "Speed": 720, "Angle": angle}
    )
    heard = rmd().hear(Frame(0x242, data))
    assert (heard.leg, heard.motion, heard.torque) == (1, (pytest.approx(angle / 360), 2.0), -7.0)


@pytest.mark.parametrize(
    ("changed", "word"),
    [
        ({"command": ""}, "missing: command"),
        ({"position": "Azimuth"}, "Azimuth"),
        ({"position": "Temperature"}, "degC"),
        ({"torque_constant_Nm_A": 0.0}, "torque_constant_Nm_A"),
        ({"velocity": "TorqueCurrent"}, "allowed: a signal of Answer"),
        ({"poll": "9c"}, "8 bytes"),
        ({"dbc": DBC.replace('"deg"', '""')}, "unit"),
        ({"dbc": "no\ndatabase"}, "not a DBC"),
        ({"dbc": "gone.dbc"}, "no such file: gone.dbc"),
        ({"poll": "a100000000000000"}, "poll: allowed: no frame of the command's torque"),
        (
            {"dbc": DBC.replace('(0.01,0) [-327.68|327.67] "A" DRIVE', '(0.01,-5) [0|0] "A" DRIVE')},
            "an offset",
        ),
        ({"dbc": DBC.replace("32|16@1-", "32|16@1+")}, "a signed signal"),
        ({"enable": "8800000000000000"}, "missing: enabled"),
        ({"dbc_node": -2000}, "identifiers 0x912 to"),
        ({"sync": "SYNC"}, "protocol dbc has"),
    ],
)
def test_incomplete_mapping_is_refused_in_one_line(changed, word):
    light = TransmissionSettings(lead_m=1e-9)
    section = DriveSettings(protocol="dbc", transmission=light, options=OPTIONS | changed)
    with pytest.raises(ConfigurationError, match=word) as refused:
        build_protocol(BusSettings(layout="classic"), section)
    assert "\n" not in str(refused.value)
