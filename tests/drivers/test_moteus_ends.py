"""moteus frame by frame: commands and answers of an emulated drive, and decoded replies."""

from __future__ import annotations

import struct
from functools import partial
from math import inf, nan
from typing import Any

import numpy as np
import pytest

from drivers.moteus import READ, REPLY, STOP, WRITE, pad, torque_command
from drivers.protocol import BRS, BUS, ERROR, EXTENDED, FD, REMOTE, Frame
from drivers.signals import INVALID, DriveFault, DriveMode, DriveState, Reaction
from hil.contracts.drives_end import command
from hil.contracts.messages import Configure, Rejected, Sync
from tests.drivers.motor_families import UNLIKE, Heard, MoteusProtocol, asked, registers, replied, sent_to

NODES = (9, 2, 3, 4, 5, 126)
P = MoteusProtocol(NODES, 1, Reaction.DAMP, 2.0, UNLIKE)
ALL = EXTENDED | FD | BRS
PER = UNLIKE.N_per_Nm
RESET, READY, RUN = DriveMode.RESET, DriveMode.READY, DriveMode.RUN


def to(leg: int, data: bytes) -> Frame:
    return Frame(0x8100 | NODES[leg], pad(data), ALL)


parsed = partial(sent_to, P)


def written(**values: float) -> Frame:
    """Position mode with some of: torque, kp, kd, most."""
    data = b"\x01\0\x0a"
    for name, register in (("torque", 0x22), ("kp", 0x23), ("kd", 0x24), ("most", 0x25)):
        if name in values:
            data += bytes((0x0D, register)) + struct.pack("<f", values[name])
    return to(1, data)


@pytest.mark.parametrize(
    ("changes", "torque"),
    [
        ({}, 0.5), ({"torque": 2.5}, 2.0), ({"torque": -2.5}, -2.0), ({"most": None}, 0.5), ({"torque": None}, 0.0),
        ({"most": nan}, 0.5), ({"most": 0.0}, None), ({"most": -1.0}, None), ({"torque": nan}, None),
        ({"kp": None}, None), ({"kd": None}, None), ({"kp": 1.0}, None),
    ],
)  # fmt: skip
def test_position_mode_command_with_zero_gains_gives_a_torque_within_the_maximum(changes, torque):
    values = {"torque": 0.5, "kp": 0.0, "kd": 0.0, "most": 2.0} | changes
    memory, (messages,) = parsed(written(**{name: x for name, x in values.items() if x is not None}))
    if torque is None:
        assert messages == (Rejected(), Sync(0, (1,)))
        assert not any(memory.enabled)
        return
    assert messages[2] == command(1, RUN, 2, torque * PER[1])
    assert messages[0] == Configure(1, 0.1, Reaction.DAMP), "its own timeout: the command has none"


@pytest.mark.parametrize(("sent_s", "kept_s"), [(0.03, 0.03), (nan, 0.1), (0.0, 0.1)])
def test_command_without_a_timeout_keeps_the_factory_watchdog_of_the_drive(sent_s, kept_s):
    _, ((first, *_),) = parsed(to(3, torque_command(0.5, 2.0, sent_s)))
    assert first.leg == 3
    assert first.watchdog_s == pytest.approx(kept_s, rel=1e-6)


def test_moteus_drive_obeys_can_fd_frames_to_its_identifier_or_to_all_drives():
    fd, enabled = FD | EXTENDED, P.power_up()._replace(enabled=(True,) * 6)
    own = [(0x104, FD), (0x8104, fd), (0xFF04, fd)]
    to_all = [(0xFFFF, fd), (0x7FF, FD), (0x7F, FD)]
    none = [(0x10104, fd), (0x804, FD), (0x8104, EXTENDED), (0x8106, fd)]
    none += [(0x8104, fd | flag) for flag in (REMOTE, ERROR, BUS)]
    for frames, legs in ((own, [3]), (to_all, list(range(6))), (none, [])):
        for identifier, flags in frames:
            memory, messages = P.parse(enabled, Frame(identifier, STOP, flags))
            assert [leg for leg in range(6) if not memory.enabled[leg]] == legs, hex(identifier)
            assert bool(messages) == bool(legs)


@pytest.mark.parametrize(
    ("state", "fault", "mode", "code"),
    [
        (DriveState.BOOT, 0, 0, 0),
        (DriveState.OFF, 3, 0, 0),
        (DriveState.READY, 0, 0, 0),
        (DriveState.RUN, 3, 10, 0),
        (DriveState.FAULT, DriveFault.WATCHDOG, 11, 0),
        (DriveState.FAULT, DriveFault.OVERFORCE, 1, 33),
        (DriveState.FAULT, DriveFault.SENSOR, 1, 35),
        (DriveState.FAULT, DriveFault.STROKE, 1, 39),
        (DriveState.FAULT, DriveFault.ESTOP, 1, 33),
        (DriveState.FAULT, DriveFault.NONE, 1, 33),
    ],
)
def test_mode_and_fault_in_the_answer_of_an_emulated_drive_follow_from_its_state(state, fault, mode, code):
    one, six, faults = np.ones(6), np.full(6, 1), np.zeros(6, np.int64)
    six[2], faults[2] = state, fault
    for leg, frame in P.answer(P.power_up(), Sync(0), one, one, one, six, faults)[1]:
        said: Any = registers(frame.data, 0x20)
        assert (said[0], said[0xF]) == ((mode, code) if leg == 2 else (0, 0))


# the controller's end


def reply(
    mode: int = 10, place: float = 0.5, speed: float = 0.25, torque: float = 1.5, fault: int = 0
) -> Frame:
    data = b"\x21\0" + struct.pack("b", mode) + b"\x2f\x01" + struct.pack("<3f", place, speed, torque)
    return Frame(4 << 8 | 1, pad(data + b"\x21\x0f" + struct.pack("b", fault)), FD | BRS)


@pytest.mark.parametrize(
    ("given", "heard"),
    [
        ({}, {"power": DriveState.RUN}),
        ({"mode": 0}, {"power": DriveState.OFF}),
        ({"mode": 9, "fault": 33}, {"power": DriveState.OFF}),
        ({"mode": 127}, {"power": DriveState.OFF}),
        ({"mode": 1, "fault": 39}, {"power": DriveState.FAULT, "fault": 0x100 + 39}),
        ({"mode": 1, "fault": 127}, {"power": DriveState.FAULT, "fault": 0x100 + 127}),
        ({"mode": 11, "fault": 39}, {"power": DriveState.FAULT, "fault": DriveFault.WATCHDOG}),
        ({"place": nan}, {"power": DriveState.RUN, "motion": None}),
        ({"speed": nan}, {"power": DriveState.RUN, "motion": None}),
        ({"torque": nan}, {"power": DriveState.RUN, "torque": None}),
        ({"mode": -1}, None),
        ({"fault": -1}, None),
        ({"place": inf}, None),
        ({"speed": -inf}, None),
        ({"torque": inf}, None),
    ],
)
def test_moteus_reply_is_decoded_to_state_fault_position_and_velocity(given, heard):
    values: dict[str, Any] = {"motion": (0.5, 0.25), "feedback": True, "torque": 1.5, "fault": 0}
    expected = Heard(3, broken=True) if heard is None else Heard(3, **values | heard)
    assert P.hear(reply(**given)) == expected


@pytest.mark.parametrize("byte", [0x50, 0xCC, 0xAA, 0x55, 0xFF])
def test_padding_bytes_at_the_end_of_a_moteus_reply_are_ignored(byte):
    data = reply().data.rstrip(b"\x50")
    assert P.hear(reply()._replace(data=data.ljust(24, bytes((byte,))))) == P.hear(reply())


def test_incomplete_moteus_reply_counts_as_invalid():
    texts = "21", "2100", "2f01000000", "ff", "210001", "2c", "2c7f7f", "7f01"
    known = (0, 1, 2, 3, 0xF)
    lacking = (b"".join(bytes((0x21, k, 1)) for k in known if k != missing) for missing in known)
    for data in (*map(bytes.fromhex, texts), *map(pad, lacking)):
        assert P.hear(Frame(4 << 8 | 1, data, FD | BRS)) == Heard(3, broken=True)


def test_moteus_reply_with_wrong_frame_flags_is_ignored():
    frame = reply()
    for flags in (BRS, *(frame.flags | wrong for wrong in (EXTENDED, REMOTE, ERROR, BUS))):
        assert P.hear(frame._replace(flags=flags)) is None
    protocol = MoteusProtocol((7, 8, 3, 4, 5, 6), 0, Reaction.DAMP, 2.0, UNLIKE)
    for leg, identifier, right, wrong in ((0, 0x700, FD, FD | EXTENDED), (1, 0x800, FD | EXTENDED, FD)):
        assert protocol.hear(frame._replace(id=identifier, flags=right)).leg == leg
        assert protocol.hear(frame._replace(id=identifier, flags=wrong)) is None


def test_command_frame_of_another_controller_counts_as_foreign_for_its_leg():
    ids = (0x0502, 1), (126, 5), (0x007F, 0), (0xFF7F, 0), (0xFF05, 4), (0xFFFF, 0), (0x7FF, 0)
    for identifier, leg in ids:
        flags = FD | EXTENDED * (identifier > 0x7FF)
        assert P.hear(Frame(identifier, STOP, flags)) == Heard(leg, foreign=True)
    assert P.hear(Frame(0x10002, STOP, FD | EXTENDED)) is None
    for flags in (0, BRS, FD | REMOTE, FD | ERROR, FD | BUS, FD | EXTENDED):
        assert P.hear(Frame(2, STOP, flags)) is None


# subframes: widths, scales, counts, and where a frame ends


SAID: dict[str, dict[int, float] | None] = {
    "50 21 00 0a 50 50": {0: 10.0},
    "21 0e 1e": {0xE: 30.0}, "25 0e 1e 00": {0xE: 3.0}, "29 0e 1e 00 00 00": {0xE: 0.03},
    "29 02 00 00 01 00": {2: 0.65536}, "25 0d 30 00": {0xD: 4.8}, "29 0d 30 00 00 00": {0xD: 0.048},
    "23 00 0a 32 f6": {0: 10.0, 1: 0.5, 2: -1.0},
    # a count of its own, a register of two bytes: 0x120 is 0xa0 0x02
    "20 04 00 0a 32 f6 01": {0: 10.0, 1: 0.5, 2: -1.0, 3: 0.5},
    "29 a0 02 01 00 00 80": {0x120: -2147483647.0}, "29 80 02 01 00 00 00": {0x100: 1.0},
    "20 00 21 00 0a": {0: 10.0},  # an empty group, then one with a register
    "21 00 0a 21 00 0b": {0: 11.0},
    # a read in between is no answer; an error ends the frame
    "11 00 21 00 0a": {0: 10.0}, "21 00 0a 31 05 01 2f": {0: 10.0}, "21 00 0a 30 05": {0: 10.0},
    # incomplete, or of another kind
    **dict.fromkeys((
        "21", "21 00", "22 00 0a", "25 00 0a", "29 00 0a 00 00", "2d 00 0a 00 00", "20", "20 04", "20 81",
        "29 a0", "23 00 0a 0a", "01 00 0a", "41 00", "21 00 0a 01 00 0a", "21 00 0a 21 00", "20 02 00 0a",
    )),
}  # fmt: skip


def test_moteus_frame_is_decoded_to_scaled_register_values_or_counts_as_invalid():
    for text, found in SAID.items():
        said = registers(bytes.fromhex(text), REPLY)
        assert said == (None if found is None else pytest.approx(found, rel=1e-12)), text
    assert registers(b"\x01\0\x0a", WRITE) == registers(b"\x1f\1\1\0\x0a", WRITE) == {0: 10.0}
    assert registers(b"\x21\0\x0a", WRITE) is None


@pytest.mark.parametrize(
    ("register", "scales"),
    [
        (0x20, {0: 0.01, 1: 0.0001, 2: 0.00001}),
        (0x21, {0: 0.1, 1: 0.00025}),
        (0x22, {0: 0.5, 2: 0.001}),
        (0x24, {1: 1.0}),
        (0x25, {0: 0.5, 1: 0.01}),
        (0x27, {0: 0.01, 1: 0.001, 2: 0.000001, 3: 1.0}),
        (0x28, {0: 1.0}),
    ],
)
def test_scale_of_a_moteus_command_value_depends_on_register_and_integer_width(register, scales):
    for width, scale in scales.items():
        number = struct.pack("<" + "bhif"[width], 3)
        found: Any = registers(bytes((WRITE | width << 2 | 1, register)) + number, WRITE)
        assert found == {register: pytest.approx(3 * scale, rel=1e-12)}


@pytest.mark.parametrize(
    ("text", "reply"),
    [
        ("14 04 00", "24 04 00 0a 00 88 13 60 f0 96 00"),
        ("12 01 11 03", "23 01 32 f6 03"),  # consecutive registers share a group
        ("11 01 15 02", "21 01 32 25 02 60 f0"),
        ("1d 01", "2d 01 00 00 00 3f"),
        ("19 03", "29 03 dc 05 00 00"),
        ("18 04 a0 02", "2b a0 02 01 00 00 00 00 00 00 00 00 00 00 00 31 a3 02 01"),
        ("11 10 11 00", "31 10 01 21 00 0a"),
        ("15 05", "25 05 00 80"),
        ("1d 05", "2d 05 00 00 c0 7f"),
        ("01 00 0a 11 03", "21 03 03"),
        ("11 03 30 11 04", "21 03 03"),  # an error ends the frame
    ],
)
def test_moteus_reply_has_the_requested_register_groups_and_an_error_for_unknown_registers(text, reply):
    assert replied(bytes.fromhex(text)) == pad(bytes.fromhex(reply))


def test_moteus_reply_is_cut_when_its_frame_is_full():
    for count in (63, 64, 65, 127):
        assert asked(bytes((READ, count, 1))) == tuple((1 + k, 0) for k in range(min(count, 64)))
    reply = replied(bytes((READ | 3 << 2, 20, 1)))
    assert len(reply) == 64
    assert reply[:3] == bytes((REPLY | 3 << 2, 15, 1))
    assert reply[63] == 0x31, "the first unknown register"
    for size in range(65):
        full = min(each for each in (*range(9), 12, 16, 20, 24, 32, 48, 64) if each >= size)
        assert pad(bytes(size)) == bytes(size) + b"\x50" * (full - size), "lengths of CAN FD"


def test_integer_registers_saturate_before_the_value_reserved_for_nan():
    for value, raw in ((1.27, 127), (1.29, 127), (9.0, 127), (-1.27, -127), (-1.28, -127), (-9.0, -127)):
        assert replied(b"\x11\1", value) == bytes((0x21, 1)) + struct.pack("b", raw)
        assert replied(b"\x11\1", value, state=DriveState.RUN | INVALID) == b"\x21\1\x80"
