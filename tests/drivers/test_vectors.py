"""One byte vector calculated by hand per message and layout: a wrong scale at both ends cannot cancel out.

Little-endian. The calculation is next to each vector; the check is divided bit by bit.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import cantools
import numpy as np
import pytest

import drivers
from drivers.config import BusSettings
from drivers.legs.protocol import LegsProtocol
from drivers.protocol import BRS, FD, Frame, Received
from drivers.sensing.settings import ImuSettings, SensorSettings, TrackerSettings, WrenchSensorSettings
from drivers.sensors import SensorProtocol
from drivers.signals import INVALID, Command, DriveFault, DriveMode, DriveState, Reaction
from hil.contracts.drives_end import reports
from hil.contracts.messages import Configure, DeviceCommand, EmergencyStop, Status, Sync
from tests.drivers.legs_frames import bitwise_crc, command_frames, decode, one_feedback, opening, parse
from tests.sensor_samples import encode

NODES = (1, 2, 3, 4, 5, 6)
RATED_N = 32_000.0
"""One step of the short force fields, 1/16000 of the rated force, is 2 N."""
P = {layout: LegsProtocol(layout, NODES, RATED_N) for layout in ("classic", "fd", "ideal")}
TWO_BUSES = LegsProtocol("fd", NODES, RATED_N, ((0, 1, 2), (3, 4, 5)))
GENERAL: Any = cantools.database.load_file(Path(drivers.__file__).parent / "legs/legs.dbc")
DATABASE: Any = cantools.database.Database()
DATABASE.add_dbc_string(P["fd"].database[1])
DATABASE.add_dbc_file(Path(drivers.__file__).parent / "sensors.dbc")
S = SensorProtocol(
    BusSettings(), SensorSettings(tracker=TrackerSettings(), imu=ImuSettings(), wrench=WrenchSensorSettings())
)
CLASSIC_FORCE = np.array([1000.0, -2000.0, 30_000.0, 2.0, -2.0, -30_000.0])
FD_FORCE = np.array([1000.5, -0.001, 60_000.0, -60_000.0, 0.0, 0.256])
IDEAL_FORCE = np.array([1.0, -2.0, 0.5, 60_000.0, 0.0, -0.75])
TICK = 423  # 0x1A7: SYNC and commands carry 0xA7, the four-bit counter is 7
HOLDS = Configure(5, 0.0125, Reaction.HOLD)


class Vector(NamedTuple):
    """A message, its frame from our codec, its bytes by hand in the format of candump, and its fields."""

    message: str
    frame: Frame
    wire: str
    values: str

    @property
    def expected(self) -> Frame:
        """Frame of these bytes; `##1`: CAN FD with bit-rate switch."""
        identifier, _, data = self.wire.partition("#")
        fd = data.startswith("#1")
        return Frame(int(identifier, 16), bytes.fromhex(data[2:] if fd else data), FD | BRS if fd else 0)

    @property
    def signals(self) -> dict[str, float]:
        pairs = (each.split("=") for each in self.values.split())
        return {name: float(value) if "." in value else int(value, 0) for name, value in pairs}


VECTORS = [
    Vector("ESTOP", P["fd"].traits.emergency_stop[0], "001#00", "Source=0"),
    Vector("SYNC", opening(P["fd"], TICK)[0], "080#A7 C3", "Cycle=167 CRC=0xC3"),
    Vector(
        "CONFIG_3",
        P["fd"].configure(0.0125, Reaction.HOLD)[2],
        # 12500 us = 0x30D4; hold = 2; third leg; version 2
        "603#D4 30 00 00  02  03  02  72",
        "Watchdog=0.0125 Reaction=2 Leg=3 Version=2 CRC=0x72",
    ),
    Vector(
        "STATUS_6",
        reports(P["fd"], Status(5, DriveState.FAULT, DriveFault.ESTOP, HOLDS))[0],
        # the CRC-16 of 06 06, D4 30 00 00 02 06 02 and 32000000 mN = 0x01E84800 is 0x3AF9
        "706#04 02  F9 3A  55",
        "State=4 Fault=2 SetUp=0x3AF9 CRC=0x55",
    ),
    Vector(
        "STATUS_6",
        reports(P["fd"], Status(5, DriveState.FAULT, DriveFault.ESTOP))[0],
        "706#04 02  00 00  39",
        "State=4 Fault=2 SetUp=0 CRC=0x39",
    ),
    Vector(
        "COMMAND_CLASSIC_A",
        command_frames(P["classic"], Command(DriveMode.RUN, CLASSIC_FORCE), TICK)[0],
        # 1000/2 = 500 = 0x01F4; -2000/2 = -1000 = 0x8000 - 0x03E8 = 0x7C18; 30000/2 = 15000 = 0x3A98; 15 bits each:
        # 0x01F4 + 0x7C18 << 15 + 0x3A98 << 30 + mode 2 << 45 = 0x4EA63E0C01F4; counter 0xA7
        "100#F4 01  0C 3E  A6 4E  A7  FF",
        "Force1=1000 Force2=-2000 Force3=30000 Mode=2 Counter=0xA7 CRC=0xFF",
    ),
    Vector(
        "COMMAND_CLASSIC_B",
        command_frames(P["classic"], Command(DriveMode.RUN, CLASSIC_FORCE), TICK)[1],
        # 2/2 = 1; -2/2 = -1 = 0x7FFF; -30000/2 = -15000 = 0x8000 - 0x3A98 = 0x4568;
        # 0x0001 + 0x7FFF << 15 + 0x4568 << 30 + mode 2 << 45 = 0x515A3FFF8001
        "101#01 80  FF 3F  5A 51  A7  C4",
        "Force4=2 Force5=-2 Force6=-30000 Mode=2 Counter=0xA7 CRC=0xC4",
    ),
    Vector(
        "COMMAND_FD",
        command_frames(P["fd"], Command(DriveMode.RUN, FD_FORCE), TICK)[0],
        # in mN: 1000500 = 0x000F4434; -1; 60000000 = 0x03938700; minus that = 0xFC6C7900; 0; 256 = 0x100
        "110##1 34 44 0F 00  FF FF FF FF  00 87 93 03  00 79 6C FC  00 00 00 00  00 01 00 00  A7  02  07 4D  00 00 00 00",
        "Force1=1000.5 Force2=-0.001 Force3=60000 Force4=-60000 Force5=0 Force6=0.256 Counter=0xA7 Mode=2 "
        "CRC=0x4D07",
    ),
    Vector(
        "COMMAND_FD_SHORT",
        command_frames(TWO_BUSES, Command(DriveMode.RUN, FD_FORCE), TICK)[0],
        # the same three of leg 1 to 3; the check begins with the bytes 11 01 of the identifier
        "111##1 34 44 0F 00  FF FF FF FF  00 87 93 03  A7  02  A1 5F",
        "Force1=1000.5 Force2=-0.001 Force3=60000 Counter=0xA7 Mode=2 CRC=0x5FA1",
    ),
    Vector(
        "COMMAND_IDEAL",
        command_frames(P["ideal"], Command(DriveMode.RUN, IDEAL_FORCE), TICK)[0],
        # IEEE 754: exponent + 1023 in 11 bits, then the fraction. 1 -> 0x3FF0..., -2 -> 0xC000..., 0.5 -> 0x3FE0...,
        # 60000 = 2^15 * 1.8310546875 -> exponent 1038 = 0x40E, fraction .8310546875 = 0xD4C/0x1000 -> 0x40ED4C...,
        # -0.75 = -2^-1 * 1.5 -> 0xBFE8...
        "120##1 00 00 00 00 00 00 F0 3F  00 00 00 00 00 00 00 C0  00 00 00 00 00 00 E0 3F  00 00 00 00 00 4C ED 40"
        "00 00 00 00 00 00 00 00  00 00 00 00 00 00 E8 BF  27  00 00 00 00 00 00 00 00 00 00 00 00 00 00  64",
        "Force1=1 Force2=-2 Force3=0.5 Force4=60000 Force5=0 Force6=-0.75 Counter=7 Mode=2 CRC=0x64",
    ),
    Vector(
        "FEEDBACK_CLASSIC_1",
        one_feedback(P["classic"], 0, 1.5, -0.25, 1234.0, DriveState.RUN, 7),
        # 1.5/1e-7 = 15000000 = 0x00E4E1C0; -0.25/1e-4 = -2500 = 0x10000 - 0x09C4 = 0xF63C; state 3 above counter 7
        "181#C0 E1 E4 00  3C F6  37  F3",
        "Length=1.5 Rate=-0.25 Counter=7 State=3 Invalid=0 CRC=0xF3",
    ),
    Vector(
        "FEEDBACK_FD_2",
        one_feedback(P["fd"], 1, 1.2345678, -0.25, 1234.0, DriveState.RUN, 7),
        # 12345678 = 0x00BC614E; -0.25/1e-7 = -2500000 = 2^32 - 0x002625A0 = 0xFFD9DA60; 1234/2 = 617 = 0x0269
        "282##1 4E 61 BC 00  60 DA D9 FF  69 02  37  41",
        "Length=1.2345678 Rate=-0.25 Force=1234 Counter=7 State=3 Invalid=0 CRC=0x41",
    ),
    Vector(
        "FEEDBACK_FD_2",
        one_feedback(P["fd"], 1, 1.2345678, -0.25, 1234.0, DriveState.RUN | INVALID, 7),
        # as before; the highest bit of byte 10 marks length and rate as invalid
        "282##1 4E 61 BC 00  60 DA D9 FF  69 02  B7  67",
        "Length=1.2345678 Rate=-0.25 Force=1234 Counter=7 State=3 Invalid=1 CRC=0x67",
    ),
    Vector(
        "FEEDBACK_IDEAL_1",
        one_feedback(P["ideal"], 0, 1.5, -0.25, 60_000.0, DriveState.RUN, 7),
        # 1.5 -> 0x3FF8...; -0.25 = -2^-2 -> 0xBFD0...; 60000 as in the command
        "381##1 00 00 00 00 00 00 F8 3F  00 00 00 00 00 00 D0 BF  00 00 00 00 00 4C ED 40  37  00 00 00 00 00 00  13",
        "Length=1.5 Rate=-0.25 Force=60000 Counter=7 State=3 Invalid=0 CRC=0x13",
    ),
    Vector(
        "TRACKER_7",
        encode(S, "tracker", (0.25, -0.5, 1.0, 0.1, -0.2, 3.0), TICK, 0.012345, 7),
        # in 0.1 um: 2500000 = 0x002625A0; -5000000 = 2^32 - 0x004C4B40 = 0xFFB3B4C0; 10000000 = 0x00989680;
        # in 2 nrad: 50000000 = 0x02FAF080; -100000000 = 2^32 - 0x05F5E100 = 0xFA0A1F00; 1500000000 = 0x59682F00;
        # 12345 us = 0x3039; Cycle; valid above counter 7; three zero bytes
        "407##1 A0 25 26 00  C0 B4 B3 FF  80 96 98 00  80 F0 FA 02  00 1F 0A FA  00 2F 68 59  39 30  A7  07  00 00 00  F4",
        "X=0.25 Y=-0.5 Z=1.0 RX=0.1 RY=-0.2 RZ=3.0 Offset=0.012345 Cycle=167 Counter=7 Validity=0 CRC=0xF4",
    ),
    Vector(
        "IMU_8",
        encode(S, "imu", (1.5, -0.25, 0.002, -9.81, 0.5, 65.534), TICK, 400e-6, 15),
        # in 0.2 mrad/s: 7500 = 0x1D4C; -1250 = 0x10000 - 0x04E2 = 0xFB1E; 10; in 2 mm/s^2: -4905 = 0x10000 - 0x1329 =
        # 0xECD7; 250 = 0x00FA; 32767 = 0x7FFF; 400 us = 0x0190; Cycle; valid above counter 15; three zero bytes
        "488##1 4C 1D  1E FB  0A 00  D7 EC  FA 00  FF 7F  90 01  A7  0F  00 00 00  5E",
        "WX=1.5 WY=-0.25 WZ=0.002 FX=-9.81 FY=0.5 FZ=65.534 Offset=0.0004 Cycle=167 Counter=15 Validity=0 "
        "CRC=0x5E",
    ),
    Vector(
        "WRENCH_9",
        encode(S, "wrench", (1234.567, -0.001, -60_000.0, 100.5, 0.0, -2.5), 256, 0.0, 16),
        # in mN and mN m: 1234567 = 0x0012D687; -1; -60000000 = 0xFC6C7900; 100500 = 0x00018894; 0; -2500 =
        # 2^32 - 0x09C4 = 0xFFFFF63C; Cycle 256 mod 256 and counter 16 mod 16 are 0
        "509##1 87 D6 12 00  FF FF FF FF  00 79 6C FC  94 88 01 00  00 00 00 00  3C F6 FF FF  00 00  00  00  00 00 00  24",
        "FX=1234.567 FY=-0.001 FZ=-60000 MX=100.5 MY=0 MZ=-2.5 Offset=0 Cycle=0 Counter=0 Validity=0 "
        "CRC=0x24",
    ),
]
by_message = pytest.mark.parametrize("vector", VECTORS, ids=lambda v: v.message)


@by_message
def test_frame_codec_writes_the_bytes_computed_by_hand(vector):
    assert vector.frame == vector.expected


@pytest.mark.parametrize("vector", [v for v in VECTORS if "CRC" in v.signals], ids=lambda v: v.message)
def test_crc_of_a_frame_covers_the_identifier_and_all_bytes_before_the_crc(vector):
    identifier, data, _ = vector.expected
    lead = identifier.to_bytes(2, "little")
    if vector.message in ("COMMAND_FD", "COMMAND_FD_SHORT"):
        at = 26 if vector.message == "COMMAND_FD" else 14
        check = data[at] + 256 * data[at + 1]
        assert bitwise_crc(lead + data[:at], 16) == check == vector.signals["CRC"]
        assert not any(data[at + 2 :])
    else:
        assert bitwise_crc(lead + data[:-1], 8) == data[-1] == vector.signals["CRC"]


def test_set_up_checksum_covers_the_config_frame_and_the_rated_force():
    config = bytes.fromhex("06 06  D4 30 00 00 02 06 02")
    assert bitwise_crc(config + bytes.fromhex("00 48 E8 01"), 16) == 0x3AF9


SHORT = [v for v in VECTORS if v.message.startswith(("COMMAND_CLASSIC", "FEEDBACK_FD"))]


@pytest.mark.parametrize("vector", SHORT, ids=lambda v: v.message)
def test_dbc_without_a_rated_force_has_forces_in_per_cent_of_the_rated_force(vector):
    decoded = GENERAL.decode_message(*vector.expected[:2], decode_choices=False)
    for name, value in vector.signals.items():
        expected = 100.0 * value / RATED_N if name.startswith("Force") else value
        assert decoded[name] == pytest.approx(expected, rel=1e-12)


@by_message
def test_cantools_decodes_and_encodes_the_hand_computed_frames_equally(vector):
    message = DATABASE.get_message_by_name(vector.message)
    identifier, data, flags = vector.expected
    assert (message.frame_id, message.is_fd) == (identifier, bool(flags & FD))
    decoded = message.decode(data, decode_choices=False)
    assert decoded == pytest.approx(vector.signals, rel=1e-15, abs=1e-15)
    assert message.encode(vector.signals, strict=True) == data


def test_hand_computed_frames_cover_every_kind_of_message():
    kinds = {message.name.rstrip("123456") for message in DATABASE.messages}
    assert {vector.message.rstrip("123456") for vector in VECTORS} == kinds


def frame_of(message: str) -> Frame:
    return next(v.expected for v in VECTORS if v.message == message)


def test_emulated_drives_decode_the_hand_computed_frames():
    assert parse(P["fd"], frame_of("ESTOP")) == EmergencyStop()
    assert parse(P["fd"], frame_of("SYNC")) == Sync(0xA7)
    configure = parse(P["fd"], frame_of("CONFIG_3"))
    assert isinstance(configure, Configure)
    assert (configure.leg, configure.reaction) == (2, Reaction.HOLD)
    assert configure.watchdog_s == pytest.approx(0.0125, rel=1e-15)
    for half, expected in (
        ("A", ((0, 1, 2), DriveMode.RUN, [1000.0, -2000.0, 30_000.0], 0xA7)),
        ("B", ((3, 4, 5), DriveMode.RUN, [2.0, -2.0, -30_000.0], 0xA7)),
    ):
        classic = parse(P["classic"], frame_of(f"COMMAND_CLASSIC_{half}"))
        assert isinstance(classic, DeviceCommand)
        assert (classic.legs, classic.mode, classic.force.tolist(), classic.counter) == expected
    fd = parse(P["fd"], frame_of("COMMAND_FD"))
    assert isinstance(fd, DeviceCommand)
    assert fd.legs == (0, 1, 2, 3, 4, 5)
    assert fd.force == pytest.approx((1000.5, -0.001, 60_000.0, -60_000.0, 0.0, 0.256), rel=1e-15)
    ideal = parse(P["ideal"], frame_of("COMMAND_IDEAL"))
    assert isinstance(ideal, DeviceCommand)
    assert (ideal.legs, ideal.mode, ideal.counter) == ((0, 1, 2, 3, 4, 5), DriveMode.RUN, 7)
    assert ideal.force.tolist() == [1.0, -2.0, 0.5, 60_000.0, 0.0, -0.75]


@pytest.mark.parametrize(
    ("layout", "message", "leg", "length", "force"),
    [
        ("classic", "FEEDBACK_CLASSIC_1", 0, 1.5, 0.0),  # no force on this wire
        ("fd", "FEEDBACK_FD_2", 1, 1.2345678, 1234.0),
        ("ideal", "FEEDBACK_IDEAL_1", 0, 1.5, 60_000.0),
    ],
)
def test_controller_decodes_the_hand_computed_frames(layout, message, leg, length, force):
    frames = [Received(0, frame_of(message)), Received(1, frame_of("STATUS_6"))]
    measurement = decode(P[layout], frames, TICK)
    assert measurement["length"][leg] == pytest.approx(length, rel=1e-15)
    assert measurement["rate"][leg] == pytest.approx(-0.25, rel=1e-15)
    assert measurement["drive_force"][leg] == force
    assert measurement["drive_state"][leg] == DriveState.RUN
    assert measurement["age"][leg] == 0
    assert measurement["drive_fault"].tolist() == [0, 0, 0, 0, 0, DriveFault.ESTOP]
    assert measurement["rejected"] == 0
