"""A moteus by itself: what an emulated one obeys and answers, and what its replies are heard as."""

from __future__ import annotations

import struct
from math import inf, nan
from typing import Any

import numpy as np
import pytest

from drivers.moteus import QUERY, STOP, pad, torque_command
from drivers.protocol import BRS, BUS, ERROR, EXTENDED, FD, REMOTE, DriveSetup, Frame
from drivers.signals import INVALID, DriveFault, DriveMode, DriveState, Reaction
from hil.contracts.by_value import Remembered
from hil.contracts.drives_end import command, plain
from hil.contracts.messages import Configure, DeviceCommand, Rejected, Sync
from tests.drivers.moteus_ends import asked, registers
from tests.drivers.motor_families import UNLIKE, Heard, MoteusProtocol

NODES = (9, 2, 3, 4, 5, 126)
P = MoteusProtocol(NODES, 1, Reaction.DAMP, 2.0, UNLIKE)
ALL = EXTENDED | FD | BRS
PER = UNLIKE.N_per_Nm
RESET, READY, RUN = DriveMode.RESET, DriveMode.READY, DriveMode.RUN


def to(leg: int, data: bytes) -> Frame:
    """Return a frame of ours to a drive, with a reply."""
    return Frame(0x8100 | NODES[leg], pad(data), ALL)


def told(*frames: Frame) -> tuple[Remembered, list[Any]]:
    memory, found = P.power_up(), []
    for frame in frames:
        memory, messages = P.parse(memory, frame)
        found.append(plain(messages))
    return memory, found


def test_drive_is_enabled_by_its_first_torque_obeys_the_next_and_resets_by_a_stop():
    torque = to(4, torque_command(0.5, 2.0, 0.03))
    memory, found = told(torque, to(4, torque_command(-0.25, 2.0, 0.04)), to(4, STOP), torque)
    kept = round(float(np.float32(0.03)), 9)
    assert found == [
        (
            Configure(4, kept, Reaction.DAMP),
            command(4, READY, 1, 0.5 * PER[4]),
            command(4, RUN, 2, 0.5 * PER[4]),
            Sync(0, (4,)),
        ),
        (command(4, RUN, 3, -0.25 * PER[4]), Sync(0, (4,))),
        (command(4, RESET, 4), Configure(4, 0.1, Reaction.DAMP), Sync(0, (4,))),
        (
            Configure(4, kept, Reaction.DAMP),
            command(4, READY, 5, 0.5 * PER[4]),
            command(4, RUN, 6, 0.5 * PER[4]),
            Sync(0, (4,)),
        ),
    ]
    assert memory.heard == (0, 0, 0, 0, 6, 0)
    assert memory.enabled == (False, False, False, False, True, False)


def written(**values: float) -> Frame:
    """Return position mode with some of: torque, kp, kd, most."""
    data = b"\x01\0\x0a"
    for name, register in (("torque", 0x22), ("kp", 0x23), ("kd", 0x24), ("most", 0x25)):
        if name in values:
            data += bytes((0x0D, register)) + struct.pack("<f", values[name])
    return to(1, data)


@pytest.mark.parametrize(
    ("values", "torque"),
    [
        ({"torque": 0.5, "kp": 0.0, "kd": 0.0, "most": 2.0}, 0.5),
        ({"torque": 2.5, "kp": 0.0, "kd": 0.0, "most": 2.0}, 2.0),
        ({"torque": -2.5, "kp": 0.0, "kd": 0.0, "most": 2.0}, -2.0),
        ({"torque": 0.5, "kp": 0.0, "kd": 0.0}, 0.5),
        ({"kp": 0.0, "kd": 0.0, "most": 2.0}, 0.0),
        ({"torque": 0.5, "kp": 0.0, "kd": 0.0, "most": nan}, 0.5),
        ({"torque": 0.5, "kp": 0.0, "kd": 0.0, "most": 0.0}, None),
        ({"torque": 0.5, "kp": 0.0, "kd": 0.0, "most": -1.0}, None),
        ({"torque": nan, "kp": 0.0, "kd": 0.0, "most": 2.0}, None),
        ({"torque": 0.5, "kd": 0.0, "most": 2.0}, None),
        ({"torque": 0.5, "kp": 0.0, "most": 2.0}, None),
        ({"torque": 0.5, "kp": 1.0, "kd": 0.0, "most": 2.0}, None),
    ],
)
def test_position_mode_is_a_torque_without_gains_and_with_a_limit_above_nothing(values, torque):
    memory, (messages,) = told(written(**values))
    if torque is None:
        assert messages == (Rejected(), Sync(0, (1,)))
        assert not any(memory.enabled)
        return
    assert messages[2] == command(1, RUN, 2, torque * PER[1])
    assert messages[0] == Configure(1, 0.1, Reaction.DAMP), "its own time: the command gives none"


@pytest.mark.parametrize(("sent_s", "kept_s"), [(0.03, 0.03), (nan, 0.1), (0.0, 0.1)])
def test_command_without_a_time_leaves_the_drive_the_delivered_one(sent_s, kept_s):
    _, ((first, *_),) = told(to(3, torque_command(0.5, 2.0, sent_s)))
    assert first.leg == 3
    assert first.watchdog_s == pytest.approx(kept_s, rel=1e-6)


def test_command_that_an_emulated_drive_does_not_have_is_refused_and_answered():
    for text in (
        "01000a0c06200000c07f000000000000003f0000803f0000803f00000040",  # gains
        "01000a0d220000003f",  # the drive's own gains
        "01000a0e200000803ecdccccbd",  # position
        "01000f",  # brake
    ):
        assert told(to(2, bytes.fromhex(text) + QUERY))[1] == [(Rejected(), Sync(0, (2,)))]
    assert told(to(2, b"\x11\0"))[1] == [(Sync(0, (2,)),)], "a query"
    assert told(to(2, b"\x01\0"))[1] == [(Rejected(),)]


def test_reply_goes_to_the_last_controller_that_wanted_one():
    memory, _ = told(Frame(0x8500 | 4, b"\x11\0", ALL), Frame(0x0600 | 4, b"\x11\1", FD | BRS))
    assert memory.asked == tuple((5, ((0, 0),)) if leg == 3 else P.power_up().asked[leg] for leg in range(6))
    memory, _ = told(Frame(0xFF00 | 4, b"\x11\0", ALL))
    assert memory.asked[3][0] == 0x7F
    assert P.power_up().asked == ((1, asked(STOP)),) * 6


def test_command_to_all_drives_is_obeyed_by_all_and_answered_where_it_asks_for_it():
    torque = pad(torque_command(0.5, 2.0, 0.1))
    memory, (messages,) = told(Frame(0x7F, torque, FD | BRS))
    assert memory.enabled == (True,) * 6
    legs = [each.legs for each in messages if isinstance(each, DeviceCommand) and each.mode == RUN]
    assert legs == [(leg,) for leg in range(6)]
    assert not [each for each in messages if isinstance(each, Sync)]
    _, messages = P.parse(memory, Frame(0x807F, torque, ALL))
    assert [each.legs for each in messages if isinstance(each, Sync)] == [(leg,) for leg in range(6)]


@pytest.mark.parametrize(
    ("identifier", "flags", "obeyed"),
    [
        (0x7FF & 0x104, FD, True),
        (0x8104, FD | EXTENDED, True),
        (0xFF04, FD | EXTENDED, True),
        (0xFFFF, FD | EXTENDED, True),
        (0x7FF, FD, True),
        (0x10104, FD | EXTENDED, False),
        (0x804, FD, False),
        (0x8104, EXTENDED, False),
        (0x8104, FD | EXTENDED | REMOTE, False),
        (0x8104, FD | EXTENDED | ERROR, False),
        (0x8104, FD | EXTENDED | BUS, False),
        (0x8106, FD | EXTENDED, False),
        (0x7F, FD, True),
    ],
)
def test_drive_obeys_a_frame_of_can_fd_to_its_identifier_or_to_all(identifier, flags, obeyed):
    enabled = P.power_up()._replace(enabled=(True,) * 6)
    memory, messages = P.parse(enabled, Frame(identifier, STOP, flags))
    stopped = [leg for leg in range(6) if not memory.enabled[leg]]
    assert stopped == ([] if not obeyed else [3] if identifier & 0x7F != 0x7F else list(range(6)))
    assert bool(messages) == obeyed


def states(**changes: Any) -> list[tuple[int, Frame]]:
    """Return what all drives answer to our query: each with numbers of its own."""
    turns = np.array([0.5, -0.5, 1.5, 2.5, -3.0, 4.0])
    given: dict[str, Any] = {"state": np.full(6, 3), "fault": np.zeros(6, np.int64)} | changes
    force = UNLIKE.force(turns * 2, UNLIKE.rate(turns / 4))
    length, rate = UNLIKE.length(turns), UNLIKE.rate(turns / 4)
    return P.answer(
        P.power_up(),
        Sync(0, given.get("legs", tuple(range(6)))),
        length,
        rate,
        force,
        given["state"],
        given["fault"],
    )[1]


def test_each_drive_answers_with_its_own_numbers_on_its_own_identifier():
    turns = (0.5, -0.5, 1.5, 2.5, -3.0, 4.0)
    sent = states(legs=(5, 0, 2))
    assert [leg for leg, _ in sent] == [5, 0, 2]
    assert [(frame.id, frame.flags) for _, frame in sent] == [
        (126 << 8 | 1, ALL),
        (9 << 8 | 1, ALL),
        (3 << 8 | 1, FD | BRS),
    ]
    for leg, frame in sent:
        said = registers(frame.data, 0x20)
        assert said is not None
        place = turns[leg]
        expected = {0: 10.0, 1: place, 2: place / 4, 3: place * 2, 0xD: 24.0, 0xE: 30.0, 0xF: 0.0}
        assert dict(said) == pytest.approx(expected, rel=1e-6)


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
def test_mode_and_fault_of_an_answer_follow_from_the_drives_state(state, fault, mode, code):
    six, faults = np.full(6, 1), np.zeros(6, np.int64)
    six[2], faults[2] = state, fault
    for leg, frame in states(state=six, fault=faults):
        said = registers(frame.data, 0x20)
        assert said is not None
        assert (said[0], said[0xF]) == ((mode, code) if leg == 2 else (0, 0))
    six[2] |= INVALID
    (_, lost), (_, there) = states(state=six, fault=faults, legs=(2, 3))
    heard, other = P.hear(lost), P.hear(there)
    assert heard is not None
    assert other is not None
    assert (heard.motion, other.motion is None) == (None, False)
    assert heard.torque == pytest.approx(3.0, rel=1e-6)


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
def test_reply_is_heard_with_its_state_fault_and_motion(given, heard):
    values: dict[str, Any] = {"motion": (0.5, 0.25), "feedback": True, "torque": 1.5, "fault": 0}
    expected = Heard(3, broken=True) if heard is None else Heard(3, **values | heard)
    assert P.hear(reply(**given)) == expected


def test_reply_that_is_not_whole_or_lacks_a_register_is_broken():
    short = [
        bytes.fromhex(each) for each in ("21", "2100", "2f01000000", "ff", "210001", "2c", "2c7f7f", "7f01")
    ]
    for missing in (0, 1, 2, 3, 0xF):
        short.append(pad(b"".join(bytes((0x21, k, 1)) for k in (0, 1, 2, 3, 0xF) if k != missing)))
    assert [P.hear(Frame(4 << 8 | 1, data, FD | BRS)) for data in short] == [Heard(3, broken=True)] * len(
        short
    )


@pytest.mark.parametrize("wrong", [EXTENDED, REMOTE, ERROR, BUS])
def test_reply_with_another_flag_is_nobodys(wrong):
    frame = reply()
    assert P.hear(frame._replace(flags=frame.flags | wrong)) is None
    assert P.hear(frame._replace(flags=BRS)) is None
    far = frame._replace(id=126 << 8 | 1)
    assert P.hear(far) is None
    there = P.hear(far._replace(flags=ALL))
    assert there is not None
    assert there.leg == 5


def test_command_of_another_controller_is_foreign_of_its_leg():
    for identifier, leg in ((0x0502, 1), (126, 5), (0x007F, 0), (0xFF7F, 0), (0xFF05, 4)):
        flags = FD | EXTENDED * (identifier > 0x7FF)
        assert P.hear(Frame(identifier, STOP, flags)) == Heard(leg, foreign=True)
    assert (
        P.hear(Frame(0xFFFF, STOP, FD | EXTENDED)) == P.hear(Frame(0x7FF, STOP, FD)) == Heard(0, foreign=True)
    )
    assert P.hear(Frame(0x10002, STOP, FD | EXTENDED)) is None
    for flags in (0, BRS, FD | REMOTE, FD | ERROR, FD | BUS, FD | EXTENDED):
        assert P.hear(Frame(2, STOP, flags)) is None


def test_reply_over_eleven_bits_is_extended():
    nodes = (7, 8, 3, 4, 5, 6)
    protocol = MoteusProtocol(nodes, 0, Reaction.DAMP, 2.0, UNLIKE)
    for leg, identifier, right, wrong in ((0, 0x700, FD, FD | EXTENDED), (1, 0x800, FD | EXTENDED, FD)):
        heard = protocol.hear(reply()._replace(id=identifier, flags=right))
        assert heard is not None
        assert (heard.leg, heard.feedback) == (leg, True)
        assert protocol.hear(reply()._replace(id=identifier, flags=wrong)) is None


def test_drive_that_ran_and_reports_off_is_stopped_in_run_and_no_other():
    six: dict[str, Any] = {"power": (1, 1, 3, 0, 4, 1), "ran": (True, False, True, True, True, True)}
    begun = P.start(DriveSetup(0.05, Reaction.DAMP, 250.0))._replace(
        torque=(0.1, 0.2, 0.3, 0.4, 0.5, 0.6), **six
    )
    for mode in DriveMode:
        polls = P.begin(begun._replace(mode=int(mode)), 0)
        for leg, frame in enumerate(polls):
            stops = mode != DriveMode.RUN or leg in (0, 5)
            data = STOP if stops else pad(torque_command(begun.torque[leg], 2.0, 0.05))
            assert frame == Frame(0x8100 | NODES[leg], data, ALL)


def test_tick_has_six_torques_with_their_queries_and_six_replies():
    commands, replies = P.traits.cyclic_frames[:6], P.traits.cyclic_frames[6:]
    assert commands == tuple(to(leg, torque_command(0.0, 2.0, 1.0)) for leg in range(6))
    assert [(frame.id, len(frame.data)) for frame in replies] == [(n << 8 | 1, 24) for n in NODES]
    assert [P.awaited(frame) for frame in P.traits.cyclic_frames] == [-1] * 6 + [n << 8 | 1 for n in NODES]
    assert P.traits.emergency_stop == tuple(to(leg, STOP) for leg in range(6))
    assert [P.addressed(frame) for frame in commands] == [(leg,) for leg in range(6)]
