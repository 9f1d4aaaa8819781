"""An emulated ODrive axis: what it obeys, refuses, remembers and sends, frame by frame."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
import pytest

from drivers.protocol import BUS, ERROR, EXTENDED, FD, REMOTE, DriveSetup, Frame, Said
from drivers.signals import Command, DriveFault, DriveMode, DriveState, Reaction
from hil.contracts.by_value import Remembered
from hil.contracts.drives_end import command, plain
from hil.contracts.messages import Answer, Configure, DeviceMessage, EmergencyStop, Rejected, Status, Sync
from tests.drivers.motor_families import UNLIKE, ODriveProtocol

NODES = (7, 1, 2, 3, 5, 62)
P = ODriveProtocol(NODES, 0.07, UNLIKE)
TOOL = Configure(4, 0.07, Reaction.BRAKE)
"""What odrivetool has set in leg 4, whose node is 5."""
SETUP = DriveSetup(0.05, Reaction.BRAKE, 250.0)
REFUSED = (Rejected(),)


def to(kind: int, data: bytes = b"", flags: int = 0, leg: int = 4) -> Frame:
    return Frame(NODES[leg] << 5 | kind, data, flags)


def state(number: int, size: int = 8) -> Frame:
    return to(0x07, struct.pack("<Ixxxx", number)[:size])


def torque(value: float, size: int = 8) -> Frame:
    return to(0x0E, struct.pack("<fxxxx", value)[:size])


TORQUE_CONTROL = to(0x0B, struct.pack("<II", 1, 1))


def told(*frames: Frame) -> tuple[Remembered, list[tuple[DeviceMessage, ...]]]:
    """Return what an axis remembers of frames, and what each of them came to."""
    memory, found = P.power_up(), []
    for frame in frames:
        memory, messages = P.parse(memory, frame)
        found.append(plain(messages))
    return memory, found


def test_poll_of_estimates_and_a_request_for_the_address_are_remote_frames_without_data():
    address = Answer(4, Frame(5 << 5 | 6, bytes.fromhex("0505000000000000")))
    polls = to(0x09, flags=REMOTE), to(0x06, flags=REMOTE)
    others = to(0x09, b"\0", REMOTE), to(0x06, b"\0", REMOTE), to(0x01, flags=REMOTE), to(0x09)
    assert told(*polls, *others)[1] == [(Sync(0, (4,)),), (address,), (), (), (), ()]


@pytest.mark.parametrize("flags", [EXTENDED, FD, ERROR, BUS, 3 * BUS])
def test_frame_with_another_flag_or_node_is_neither_obeyed_nor_heard(flags):
    enabled = P.power_up()._replace(enabled=(True,) * 6)
    for frame in (torque(0.5), state(1), to(0x02), to(0x09, flags=REMOTE), to(0x06, flags=REMOTE), to(0x0D)):
        assert P.parse(enabled, frame._replace(flags=frame.flags | flags)) == (enabled, ())
        assert P.hear(frame._replace(flags=frame.flags | flags)) is None
    for kind, data in ((0x01, bytes(8)), (0x09, bytes(8)), (0x06, b"\5" + bytes(7))):
        assert P.hear(to(kind, data, flags)) is None
        assert P.identity(to(kind, data, flags)) is None
    for kind in range(32):
        frame = Frame(8 << 5 | kind, bytes(8))
        assert P.parse(enabled, frame) == (enabled, ())
        assert P.hear(frame) is P.identity(frame) is None
        assert P.addressed(frame) == ()


def test_frame_that_the_axis_does_not_have_is_refused_and_what_no_controller_sends_is_ignored():
    taken = {0x02, 0x06, 0x07, 0x0B, 0x0E, 0x18}
    ignored = {0x00, 0x01, 0x03, 0x05, 0x08, 0x09, 0x0A, 0x14, 0x15, 0x17, 0x1C, 0x1D, 0x1E}
    for kind in set(range(32)) - taken:
        assert told(to(kind, bytes(8)))[1] == [() if kind in ignored else REFUSED], hex(kind)
    enabled = P.power_up()._replace(enabled=(True,) * 6)
    memory, messages = P.parse(enabled, to(0x02))
    assert messages == (EmergencyStop((4,)),)
    assert memory == enabled._replace(enabled=(True, True, True, True, False, True))
    for kind, sizes in ((0x07, (4, 8)), (0x0B, (8,)), (0x0E, (4, 8)), (0x18, (0, 1))):
        for size in range(9):
            (messages,) = told(to(kind, b"\1\0\0\0\0\0\0\0"[:size]))[1]
            assert (messages == REFUSED) == (size not in sizes), (hex(kind), size)


def test_axis_closes_its_loop_under_torque_control_alone_and_counts_its_commands():
    frames = state(8), to(0x0B, struct.pack("<II", 2, 1)), state(8), TORQUE_CONTROL, torque(0.5), state(8, 4)
    frames += state(8), torque(0.5), torque(-0.25, 4), torque(float("nan")), state(1), torque(0.5), state(8)
    memory, found = told(*frames, to(0x18, b"\0"), torque(0.5))
    ready, run = DriveMode.READY, DriveMode.RUN
    per = float(UNLIKE.N_per_Nm[4])
    assert found == [
        REFUSED,
        (),
        REFUSED,
        (),
        (),
        (TOOL, command(4, ready, 1), command(4, run, 2)),
        (),
        (command(4, run, 3, 0.5 * per),),
        (command(4, run, 4, -0.25 * per),),
        REFUSED,
        (command(4, DriveMode.OFF, 5), TOOL),
        (),
        (command(4, ready, 6), command(4, run, 7)),
        (command(4, DriveMode.RESET, 8),),
        (),
    ]
    assert memory.heard == (0, 0, 0, 0, 8, 0)
    assert memory.enabled == (False,) * 6
    assert memory.registers[4][:2] == [1.0, 1.0]
    assert memory.registers[:4] == ([0.0] * 8,) * 4
    assert told(to(0x18))[1] == [(command(4, DriveMode.RESET, 1),)], "errors are cleared without data too"
    for number in (0, 2, 3, 7, 9):
        memory, found = told(TORQUE_CONTROL, state(8), state(number))
        assert (found[-1], memory.enabled[4]) == (REFUSED, True), "neither idle nor closed loop"


@pytest.mark.parametrize(
    ("fault", "error"),
    [
        (DriveFault.NONE, 0),
        (DriveFault.WATCHDOG, 0x1000000),
        (DriveFault.ESTOP, 0x2000000),
        (DriveFault.OVERFORCE, 0x1000),
        (DriveFault.SENSOR, 0x8),
        (DriveFault.STROKE, 0x10000),
    ],
)
def test_heartbeat_has_the_error_of_a_fault_and_closed_loop_in_run_alone(fault, error):
    for now in DriveState:
        _, (beat,) = P.report(P.power_up(), Status(4, now, fault))
        closed = 8 if now == DriveState.RUN else 1
        assert beat == Frame(5 << 5 | 1, struct.pack("<IBBBB", error, closed, 0, 0, 0))
    assert P.report(P.power_up(), Status(4, DriveState.FAULT, fault, due=False))[1] == ()


@pytest.mark.parametrize(
    ("error", "axis", "power", "fault"),
    [
        (0, 8, DriveState.RUN, 0),
        (0, 9, DriveState.OFF, 0),
        (0x1000000, 1, DriveState.FAULT, DriveFault.WATCHDOG),
        (0x2000000, 8, DriveState.FAULT, DriveFault.ESTOP),
        (0x3000000, 8, DriveState.FAULT, 0x3000100),
        (0x80000000, 1, DriveState.FAULT, 0x80000100),
    ],
)
def test_error_of_a_heartbeat_is_a_known_fault_or_the_axis_own(error, axis, power, fault):
    said: Any = P.hear(Frame(5 << 5 | 1, struct.pack("<IBBBB", error, axis, 9, 9, 9)))
    assert (said.leg, said.power, said.fault) == (4, power, fault)
    assert {said.feedback, said.broken, said.foreign} == {False}
    assert P.fault_text(0x2108) == "missing estimate, motor over temperature"


def test_heartbeat_or_estimate_of_another_length_is_broken():
    for kind in (0x01, 0x09):
        for size in (0, 4, 7):
            heard = P.hear(to(kind, bytes(size)))
            assert (heard.leg, heard.broken, heard.feedback) == (4, True, False)


def test_address_is_of_eight_bytes_from_its_own_node_and_not_a_request():
    data = bytes.fromhex("05010203040506ff")
    assert P.identity(to(0x06, data)) == Said(4, "serial number", 0x060504030201)
    for other in (to(0x06, data, REMOTE), to(0x06, data[:7]), to(0x05, data), to(0x06, b"\4" + data[1:])):
        assert P.identity(other) is None
    assert P.hear(to(0x06, data)) is None
    assert P.traits.identity_requests == (tuple(Frame(node << 5 | 6, b"", REMOTE) for node in NODES),)


# what the controller asks an axis for


def test_axis_is_asked_again_where_it_reports_late_that_its_loop_is_open_and_never_ran():
    power = (DriveState.OFF, DriveState.OFF, DriveState.RUN, DriveState.OFF, DriveState.OFF, DriveState.OFF)
    known = P.start(SETUP)._replace(
        mode=int(DriveMode.RUN),
        said=(30, 19, 30, 31, 30, 30),
        asked=(20, 10, 20, 20, 21, 20),
        power=tuple(map(int, power)),
        ran=(False,) * 5 + (True,),
    )
    dialogue, frames = P.command(known, Command(DriveMode.RUN, np.zeros(6)), 40)
    assert [frame.id >> 5 for frame in frames if frame.id & 0x1F == 0x07] == [NODES[0], NODES[3]]
    assert dialogue.asked == (40, 10, 20, 40, 21, 20)
    kinds = [frame.id & 0x1F for frame in frames]
    assert kinds == [0x07, 0x0E, 0x0E, 0x0E, 0x07, 0x0E, 0x0E, 0x0E]


def test_axis_counts_as_enabled_after_run_until_it_reports_otherwise():
    off, run, fault = int(DriveState.OFF), int(DriveState.RUN), int(DriveState.FAULT)
    power = (off, run, fault, 0, off, off)
    for before in DriveMode:
        for after in DriveMode:
            known = P.start(SETUP)._replace(mode=int(before), power=power)
            dialogue, _ = P.command(known, Command(after, np.zeros(6)), 40)
            left = before == DriveMode.RUN != after
            assert dialogue.power == ((run, run, fault, 0, run, run) if left else power)
