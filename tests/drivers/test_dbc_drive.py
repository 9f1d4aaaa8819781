"""Drives from a DBC: bytes of MyActuator and VESC, a peer library's encoding, and refused mappings."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cantools
import numpy as np
import pytest

from drivers import build_protocol
from drivers.config import BusSettings, DriveSettings, TransmissionSettings
from drivers.errors import ConfigurationError, ProtocolError
from drivers.protocol import EXTENDED, DriveSetup, Frame
from drivers.signals import Command, DriveMode, DriveState, Reaction
from hil.contracts.trouble import TroubleContract
from tests.drivers.motor_families import GEAR, SINCE_NS, UNIT, Motors, begun, made, measured

ROOT = Path(__file__).parents[2]
DBC = (ROOT / "docs/examples/drives/rmd.dbc").read_text("utf-8")
VECTORS = json.loads((ROOT / "tests/data/drives/dbc_rmd.json").read_text("utf-8"))["vectors"]
COMMANDS = [
    each for each in VECTORS if each["data"].startswith("a1000000") and each["data"] != "a100000000800000"
]
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


STATE = """BO_ 2147484600 State: 3 DRIVE
 SG_ Torque : 0|12@1- (0.5,0) [0|0] "Nm" CONTROLLER
 SG_ Fault : 12|4@1+ (1,0) [0|0] "" CONTROLLER
 SG_ Enabled : 16|1@1+ (1,0) [0|0] "" CONTROLLER
"""


class TestOtherByTimer(TestOther):
    """Power state and fault in a second message, and no poll."""

    # the timer samples up to 50 us beside the plant's steps: lengths of moving legs are not exact here
    SPEED = 0.01
    test_feedback_is_fresh_and_carries_length_rate_force_and_state = None  # type: ignore[assignment]
    test_readings_and_commands_are_exact_to_the_stated_resolution = None  # type: ignore[assignment]

    @pytest.fixture
    def family(self):
        first, last = OTHER_DBC.index(" SG_ Torque : 40"), OTHER_DBC.index("VAL_")
        text = OTHER_DBC[:first] + STATE + OTHER_DBC[last:].replace("2147484500", "2147484600")
        options = OTHER_OPTIONS | {"dbc": text, "torque": "State.Torque", "period_ms": 4}
        del options["poll"]
        return Motors(made("dbc", (1, 2, 3, 4, 5, 32), GEAR, options))


VESC_DBC = (ROOT / "docs/examples/drives/vesc.dbc").read_text("utf-8")
VESC_VECTORS = json.loads((ROOT / "tests/data/drives/dbc_vesc.json").read_text("utf-8"))["vectors"]
VESC_OPTIONS: dict[str, Any] = {
    "dbc": VESC_DBC,
    "period_ms": 4,
    "position": "Tachometer",
    "velocity": "MotorSpeed",
    "current": "MotorCurrent",
    "command": "SetCurrent.Current",
    "torque_constant_Nm_A": 0.5,
    "disable": "00000201#00000000",
}
VESC_NODES = (1, 2, 23, 4, 10, 255)
POLES = 7
VESC_STEP, VESC_STEP_s = 0.1 / 6 / POLES, 0.1 / 60 / POLES
NEWTONS = 0.5 * 2 * np.pi / 0.1


def vesc(gear: Any = UNIT, **changed: Any) -> Any:
    return Motors(made("dbc", VESC_NODES, gear, VESC_OPTIONS | changed))


class TestVesc(TroubleContract):
    """Two status messages a reading, sent by the drives' timer, 29-bit identifiers, commanded by current."""

    # the timer samples up to 50 us beside the plant's steps
    RESOLUTION = (2 * VESC_STEP + 1e-4, 2 * VESC_STEP_s, 2 * 0.1 * NEWTONS, 2e-3 * NEWTONS)
    SETS_WATCHDOG = TELLS_BOOT = WATCHED = TELLS_FAULTS = False
    RESTART = "obeys"
    LENGTHS, SPEED = (1.75 - 5e7 * 0.1, 1.75 + 5e7 * 0.1), 1.0

    @pytest.fixture
    def family(self):
        return vesc(GEAR)


def of_vesc(what: str) -> list[dict[str, Any]]:
    return [each for each in VESC_VECTORS if each["what"] == f"CAN_PACKET_{what}"]


def from_vesc(vector: dict[str, Any]) -> Frame:
    return Frame(vector["id"], bytes.fromhex(vector["data"]), EXTENDED)


@pytest.mark.parametrize("vector", of_vesc("STATUS") + of_vesc("STATUS_5"), ids=lambda v: v["data"])
def test_status_of_the_vesc_firmware_is_decoded_to_its_values(vector):
    heard = vesc().hear(from_vesc(vector))
    assert heard.leg == VESC_NODES.index(vector["node"])
    if "erpm" in vector:
        assert heard.motion == (0.0, pytest.approx(vector["erpm"] / POLES / 60))
        assert heard.torque == pytest.approx(0.5 * vector["current_A"])
    else:
        assert heard.motion == (pytest.approx(vector["tachometer_count"] / 6 / POLES), 0.0)


@pytest.mark.parametrize(
    "vector", of_vesc("STATUS_2") + of_vesc("STATUS_4") + of_vesc("STATUS_6"), ids=lambda v: v["data"]
)
def test_status_of_the_vesc_without_position_or_speed_is_no_reading(vector):
    assert vesc().hear(from_vesc(vector)) is None


@pytest.mark.parametrize("vector", of_vesc("SET_CURRENT"), ids=lambda v: v["data"])
def test_current_command_has_the_bytes_of_the_vesc_firmware(vector):
    protocol = vesc()
    force = np.full(6, 0.5 * vector["current_A"]) * UNIT.N_per_Nm
    _, frames = protocol.command(begun(protocol), Command(DriveMode.RUN, force), 13)
    assert frames[1::2][VESC_NODES.index(vector["node"])] == from_vesc(vector)


def test_disabling_frame_of_the_vesc_is_a_brake_current_of_zero():
    (first,) = (from_vesc(each) for each in of_vesc("SET_CURRENT_BRAKE") if each["current_A"] == 0)
    protocol = vesc()
    _, frames = protocol.command(begun(protocol), Command(DriveMode.OFF, np.zeros(6)), 13)
    assert frames[0] == protocol.traits.emergency_stop[0] == first


SPEED = [each for each in of_vesc("STATUS") if each["node"] == 10 and each["erpm"]]
PLACE = [each for each in of_vesc("STATUS_5") if each["data"][:4] in ("fffe", "0000")]


def test_reading_of_the_vesc_needs_both_messages_of_one_period():
    leg, ms = VESC_NODES.index(10), 1_000_000
    (a, b), (old, new) = map(from_vesc, SPEED[:2]), map(from_vesc, PLACE[:2])

    def reading(*frames: tuple[int, Frame]) -> tuple[float, float] | None:
        tick, _ = measured(vesc(), *((SINCE_NS + t, each) for t, each in frames))
        return (tick["length"][leg], tick["rate"][leg]) if tick["age"][leg] == 0 else None

    def means(place: int, speed: int) -> Any:
        n, m = PLACE[place]["tachometer_count"], SPEED[speed]["erpm"]
        return pytest.approx((n / 6 / POLES, m / 60 / POLES))

    assert reading((0, a)) is None
    assert reading((0, old)) is None
    assert reading((0, a), (ms, new)) == means(1, 0)
    assert reading((0, old), (3 * ms, a)) is None, "of two periods"
    assert reading((0, old), (3 * ms, a), (3 * ms + 100, new)) == means(1, 0)
    assert reading((0, a), (100, old), (3 * ms, b), (3 * ms + 100, new)) == means(1, 1), "the newest counts"
    assert reading((-3 * ms, a), (-2 * ms, new)) == means(1, 0), "from before the tick, within a period"
    assert reading((-8 * ms, a), (-7 * ms, new)) is None, "late"


def test_timer_slower_than_the_loop_is_refused():
    with pytest.raises(ProtocolError, match=r"period_ms: 5 ms, allowed: up to the loop's period, 4 ms"):
        vesc(period_ms=5).start(DriveSetup(0.05, Reaction.BRAKE, 250.0))


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


@pytest.mark.parametrize(
    "vector", [each for each in VECTORS if each["data"][:2] in ("80", "81")], ids=lambda v: v["key"]
)
def test_stop_and_shutdown_of_the_maker_disable_the_drive(vector):
    stop = rmd(disable=vector["data"]).traits.emergency_stop[0]
    assert stop == Frame(vector["id"], bytes.fromhex(vector["data"]))


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
        ({"velocity": "Answer.Angle"}, "shares bits"),
        ({"poll": None}, "missing: poll, or period_ms"),
        ({"period_ms": 5}, "poll and period_ms, allowed: one"),
        ({"torque": "Answer.Current"}, "torque and current, allowed: one"),
        ({"disable": "9c00000000000000"}, "poll and disable are the same frame"),
        ({"disable": "a100000000000000"}, "disable: allowed: no frame of the command's torque"),
        ({"disable": "142#00"}, "0x142 and 0x141 of frames to one drive"),
        ({"disable": "0141#00"}, "an identifier of 3 digits"),
        ({"dbc": DBC.replace("Speed m156", "Speed m157")}, "allowed: a signal of Answer"),
        ({"dbc": DBC.replace("Angle m156 : 48|16@1- (1,0)", "Angle m156 : 48|16@1- (0,0)")}, "has no range"),
        ({"dbc": DBC.replace("Speed m156 : 32|16@1-", "Speed m156 : 32|16@1+")}, "a signed signal"),
        ({"dbc": DBC.replace("Angle m156 : 48|16@1-", "Angle m156 : 56|16@1-")}, "beyond the 8 bytes"),
        ({"dbc": DBC.replace("Angle m156 : 48|16@1-", "Angle m156 : 0|16@1-")}, "shares bits"),
        ({"dbc": DBC.replace("577 Answer: 8", "577 Answer: 12")}, "is no classic frame"),
        ({"dbc": DBC.replace("BO_ 577", "BO_ 322")}, "same identifier, 0x142"),
        ({"dbc": DBC.replace("BO_ 577", "BO_ 2147484225")}, "unlike width"),
        ({"dbc": DBC.replace("Current m156 : 16|16@1-", "Current m156 : 16|1@1-")}, "has no range"),
        ({"poll": "9c"}, "8 bytes"),
        ({"dbc": DBC.replace('"deg"', '""')}, "unit"),
        ({"dbc": "no\ndatabase"}, "not a DBC"),
        ({"dbc": "gone.dbc"}, "no such file: gone.dbc"),
        ({"poll": "a100000000000000"}, "poll: allowed: no frame of the command's torque"),
        (
            {"dbc": DBC.replace('(0.01,0) [-327.68|327.67] "A" DRIVE', '(0.01,-5) [0|0] "A" DRIVE')},
            "an offset",
        ),
        (
            {"dbc": DBC.replace("TorqueCurrent m161 : 32|16@1-", "TorqueCurrent m161 : 32|16@1+")},
            "a signed signal",
        ),
        ({"enable": "8800000000000000"}, "missing: enabled"),
        ({"dbc_node": -2000}, "identifiers 0x912 to"),
        ({"sync": "SYNC"}, "protocol dbc has"),
    ],
)
def test_incomplete_mapping_is_refused_in_one_line(changed, word):
    light = TransmissionSettings(lead_m=1e-9)
    options = {key: value for key, value in (OPTIONS | changed).items() if value is not None}
    section = DriveSettings(protocol="dbc", transmission=light, options=options)
    with pytest.raises(ConfigurationError, match=word) as refused:
        build_protocol(BusSettings(layout="classic"), section)
    assert "\n" not in str(refused.value)


def test_fault_code_with_its_highest_bit_is_no_watchdog_and_a_reported_one_bit_power_is_enabled():
    text = OTHER_DBC.replace("Fault : 52|4@1+", "Fault : 52|4@1-").replace("56|1@1+", "56|1@1-")
    protocol = Motors(made("dbc", (1, 2, 3, 4, 5, 32), UNIT, OTHER_OPTIONS | {"dbc": text}))
    fault = protocol.hear(Frame(852, bytes(6) + b"\xf0\x01", EXTENDED)).fault
    assert fault == 0x100 + 15
    assert protocol.hear(Frame(852, bytes(7) + b"\x01", EXTENDED)).power == DriveState.RUN


@pytest.mark.parametrize(("sign", "low"), [("+", 0.0), ("-", -1.0)])
def test_lengths_that_a_drive_reports_are_those_of_its_signal(sign, low):
    limits = "[0|360]" if sign == "+" else "[-360|360]"
    text = DBC.replace("48|16@1- (1,0) [-32768|32767]", f"48|16@1{sign} (1,0) {limits}")
    found = rmd(UNIT, dbc=text).traits.reported_lengths
    assert [float(each[0]) for each in found] == [low, 1.0], "m, at a lead of 1 m"
