"""An emulated ODrive axis: what it obeys, refuses, remembers and sends, frame by frame."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
import pytest

from drivers.errors import ConfigurationError, ProtocolError
from drivers.protocol import BUS, ERROR, EXTENDED, FD, REMOTE, DriveSetup, Frame, Said
from drivers.signals import INVALID, Command, DriveFault, DriveMode, DriveState, Reaction
from hil.contracts.by_value import Remembered
from hil.contracts.drives_end import command, plain
from hil.contracts.messages import Answer, Configure, DeviceMessage, EmergencyStop, Rejected, Status, Sync
from tests.drivers.motor_families import ODriveProtocol
from tests.drivers.spoken_drives import UNLIKE

NODES = (7, 1, 2, 3, 5, 62)
P = ODriveProtocol(NODES, 0.07, UNLIKE)
TOOL = Configure(4, 0.07, Reaction.BRAKE)
"""What odrivetool has set in leg 4, whose node is 5."""
TORQUE_CONTROLLED = struct.pack("<II", 1, 1)


def to(kind: int, data: bytes = b"", flags: int = 0, leg: int = 4) -> Frame:
    return Frame(NODES[leg] << 5 | kind, data, flags)


def state(number: int, size: int = 8) -> Frame:
    return to(0x07, struct.pack("<Ixxxx", number)[:size])


def torque(value: float, size: int = 8) -> Frame:
    return to(0x0E, struct.pack("<fxxxx", value)[:size])


def told(*frames: Frame) -> tuple[Remembered, list[tuple[DeviceMessage, ...]]]:
    """Return what an axis remembers of frames, and what each of them came to."""
    memory, found = P.power_up(), []
    for frame in frames:
        memory, messages = P.parse(memory, frame)
        found.append(plain(messages))
    return memory, found


def test_a_poll_of_estimates_is_a_remote_frame_without_data():
    _, found = told(to(0x09, flags=REMOTE), to(0x09, b"\0", REMOTE), to(0x01, flags=REMOTE), to(0x09))
    assert found == [(Sync(0, (4,)),), (), (), ()]


def test_a_request_for_its_address_is_answered_with_its_node_and_serial_number():
    _, found = told(to(0x06, flags=REMOTE), to(0x06, b"\0", REMOTE))
    assert found == [(Answer(4, Frame(5 << 5 | 6, bytes.fromhex("0505000000000000"))),), ()]
    said = P.identity(Frame(5 << 5 | 6, bytes.fromhex("05010203040506ff")))
    assert said == Said(4, "serial number", 0x060504030201)


@pytest.mark.parametrize("flags", [EXTENDED, FD, ERROR, BUS, 3 * BUS])
def test_frames_that_are_no_plain_ones_of_this_bus_are_neither_obeyed_nor_heard(flags):
    enabled = P.power_up()._replace(enabled=(True,) * 6)
    for frame in (torque(0.5), state(1), to(0x02), to(0x09, flags=REMOTE), to(0x06, flags=REMOTE), to(0x0D)):
        assert P.parse(enabled, frame._replace(flags=frame.flags | flags)) == (enabled, ())
        assert P.hear(frame._replace(flags=frame.flags | flags)) is None
    for kind, data in ((0x01, bytes(8)), (0x09, bytes(8)), (0x06, b"\5" + bytes(7))):
        assert P.hear(to(kind, data, flags)) is None
        assert P.identity(to(kind, data, flags)) is None


def test_a_frame_to_a_node_of_nobody_is_ignored_at_both_ends():
    for kind in range(32):
        frame = Frame(8 << 5 | kind, bytes(8))
        assert P.parse(P.power_up(), frame) == (P.power_up(), ())
        assert P.hear(frame) is None
        assert P.addressed(frame) == ()
        assert P.identity(frame) is None


def test_a_stop_of_any_length_stops_its_axis_alone():
    enabled = P.power_up()._replace(enabled=(True,) * 6)
    for size in (0, 8):
        memory, messages = P.parse(enabled, to(0x02, bytes(size)))
        assert messages == (EmergencyStop((4,)),)
        assert memory == enabled._replace(enabled=(True, True, True, True, False, True))


@pytest.mark.parametrize(
    "kind", [0x04, 0x0C, 0x0D, 0x0F, 0x10, 0x11, 0x12, 0x13, 0x16, 0x19, 0x1A, 0x1B, 0x1F]
)
def test_what_a_controller_may_send_and_an_emulated_axis_does_not_have_is_refused(kind):
    assert told(to(kind, bytes(8)))[1] == [(Rejected(),)]


@pytest.mark.parametrize(
    "kind", [0x00, 0x01, 0x03, 0x05, 0x08, 0x09, 0x0A, 0x14, 0x15, 0x17, 0x1C, 0x1D, 0x1E]
)
def test_what_no_controller_sends_is_ignored(kind):
    assert told(to(kind, bytes(8)))[1] == [()]


@pytest.mark.parametrize(("kind", "taken"), [(0x07, (4, 8)), (0x0B, (8,)), (0x0E, (4, 8)), (0x18, (0, 1))])
def test_a_command_of_another_length_than_its_own_is_refused(kind, taken):
    for size in range(9):
        (messages,) = told(to(kind, b"\1\0\0\0\0\0\0\0"[:size]))[1]
        refused = (Rejected(),)
        assert (messages == refused) == (size not in taken), size


def test_an_axis_closes_its_loop_under_torque_control_alone_and_counts_its_commands():
    memory, found = told(
        state(8),
        to(0x0B, struct.pack("<II", 2, 1)),
        state(8),
        to(0x0B, TORQUE_CONTROLLED),
        torque(0.5),
        state(8, 4),
        state(8),
        torque(0.5),
        torque(-0.25, 4),
        torque(float("nan")),
        state(1),
        torque(0.5),
        state(8),
        to(0x18, b"\0"),
        torque(0.5),
    )
    lack = (Rejected(),)
    ready, run = DriveMode.READY, DriveMode.RUN
    per = float(UNLIKE.N_per_Nm[4])
    assert found == [
        lack,
        (),
        lack,
        (),
        (),
        (TOOL, command(4, ready, 1), command(4, run, 2)),
        (),
        (command(4, run, 3, 0.5 * per),),
        (command(4, run, 4, -0.25 * per),),
        (Rejected(),),
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


@pytest.mark.parametrize("number", [0, 2, 3, 7, 9])
def test_an_axis_state_that_is_neither_idle_nor_closed_loop_is_refused(number):
    memory, found = told(to(0x0B, TORQUE_CONTROLLED), state(8), state(number))
    assert found[-1] == (Rejected(),)
    assert memory.enabled == (False, False, False, False, True, False)


def test_errors_are_cleared_by_a_frame_without_data_too():
    assert told(to(0x18))[1] == [(command(4, DriveMode.RESET, 1),)]


def test_axes_that_were_switched_off_and_on_remember_nothing_and_the_others_all():
    memory, _ = told(to(0x0B, TORQUE_CONTROLLED), state(8))
    both, _ = P.parse(memory, to(0x0B, TORQUE_CONTROLLED, leg=0))
    after = P.restarted(both, (4,))
    assert after == P.power_up()._replace(registers=[both.registers[0], *[[0.0] * 8] * 5])
    assert P.restarted(both, ()) == both


def test_an_axis_answers_with_its_own_motion_and_without_its_encoder_with_no_number():
    places = np.array([0.5, -0.5, 1.5, 2.5, -3.0, 4.0])
    speeds = places / 4
    length, rate = UNLIKE.length(places), UNLIKE.rate(speeds)
    states = np.array([1, 2, 3, 4, 3 | INVALID, 1])
    _, sent = P.answer(P.power_up(), Sync(0, (5, 4, 2)), length, rate, np.zeros(6), states)
    assert [leg for leg, _ in sent] == [5, 4, 2]
    assert [frame.id for _, frame in sent] == [62 << 5 | 9, 5 << 5 | 9, 2 << 5 | 9]
    for k, leg in ((0, 5), (2, 2)):
        assert struct.unpack("<ff", sent[k][1].data) == pytest.approx((places[leg], speeds[leg]), rel=1e-6)
    assert np.isnan(struct.unpack("<ff", sent[1][1].data)).all()


@pytest.mark.parametrize("which", [0, 1, 2])
def test_what_is_no_number_is_no_feedback(which):
    given: Any = [np.ones(6), np.ones(6), np.ones(6)]
    given[which][3] = np.nan
    with pytest.raises(ProtocolError, match="not a number"):
        P.answer(P.power_up(), Sync(0), given[0], given[1], given[2], np.ones(6, np.int64))
    _, sent = P.answer(
        P.power_up(), Sync(0, (0, 1, 2, 4, 5)), given[0], given[1], given[2], np.ones(6, np.int64)
    )
    assert len(sent) == 5, "the others'"


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
def test_a_heartbeat_has_the_error_of_a_fault_and_closed_loop_in_run_alone(fault, error):
    for now in DriveState:
        _, (beat,) = P.report(P.power_up(), Status(4, now, fault))
        closed = 8 if now == DriveState.RUN else 1
        assert beat == Frame(5 << 5 | 1, struct.pack("<IBBBB", error, closed, 0, 0, 0))
    assert P.report(P.power_up(), Status(4, DriveState.FAULT, fault, due=False))[1] == ()


def test_a_heartbeat_with_one_error_known_by_name_is_that_and_with_more_the_axis_own():
    def heard(error: int, axis: int = 8) -> Any:
        return P.hear(Frame(5 << 5 | 1, struct.pack("<IBBBB", error, axis, 9, 9, 9)))

    for error, axis, power, fault in (
        (0, 8, DriveState.RUN, 0),
        (0, 1, DriveState.OFF, 0),
        (0, 9, DriveState.OFF, 0),
        (0x1000000, 1, DriveState.FAULT, DriveFault.WATCHDOG),
        (0x2000000, 8, DriveState.FAULT, DriveFault.ESTOP),
        (0x3000000, 8, DriveState.FAULT, 0x3000100),
        (0x1000, 1, DriveState.FAULT, 0x1100),
        (0x80000000, 1, DriveState.FAULT, 0x80000100),
    ):
        said = heard(error, axis)
        assert (said.leg, said.power, said.fault) == (4, power, fault)
        assert {said.feedback, said.broken, said.foreign} == {False}


@pytest.mark.parametrize("size", [0, 4, 7])
def test_a_heartbeat_or_an_estimate_of_another_length_cannot_be_trusted(size):
    for kind in (0x01, 0x09):
        heard = P.hear(to(kind, bytes(size)))
        assert heard is not None
        assert (heard.leg, heard.broken, heard.feedback) == (4, True, False)


def test_an_address_is_of_eight_bytes_from_its_own_node_and_no_request():
    data = bytes.fromhex("05010203040506ff")
    assert P.identity(to(0x06, data)) is not None
    for other in (to(0x06, data, REMOTE), to(0x06, data[:7]), to(0x05, data), to(0x06, b"\4" + data[1:])):
        assert P.identity(other) is None
    assert P.hear(to(0x06, data)) is None
    requests = P.traits.identity_requests
    assert requests == (tuple(Frame(node << 5 | 6, b"", REMOTE) for node in NODES),)


def test_a_tick_is_six_polls_six_torques_and_six_estimates():
    polls, torques, estimates = (P.traits.cyclic_frames[k : k + 6] for k in (0, 6, 12))
    assert len(P.traits.cyclic_frames) == 18
    assert polls == tuple(Frame(node << 5 | 9, b"", REMOTE) for node in NODES)
    assert torques == tuple(Frame(node << 5 | 0x0E, bytes(8)) for node in NODES)
    assert [each._replace(data=b"") for each in estimates] == [Frame(node << 5 | 9, b"") for node in NODES]
    assert {struct.unpack("<ff", each.data) for each in estimates} == {(0.0, 0.0)}
    assert P.traits.emergency_stop == tuple(Frame(node << 5 | 2, b"") for node in NODES)
    assert P.traits.feedback_ids == {node << 5 | 9 for node in NODES}
    assert [P.awaited(frame) for frame in polls + torques] == [-1] * 12
    assert [P.awaited(frame) for frame in estimates] == [node << 5 | 9 for node in NODES]


def test_an_axis_is_asked_again_where_it_says_late_enough_that_its_loop_is_open_and_it_never_ran():
    said, asked = (30, 19, 30, 31, 30, 30), (20, 10, 20, 20, 21, 20)
    power = (DriveState.OFF, DriveState.OFF, DriveState.RUN, DriveState.OFF, DriveState.OFF, DriveState.OFF)
    start = P.start(DriveSetup(0.05, Reaction.BRAKE, 250.0))
    known = start._replace(
        mode=int(DriveMode.RUN),
        said=said,
        asked=asked,
        power=tuple(map(int, power)),
        ran=(False,) * 5 + (True,),
    )
    dialogue, frames = P.command(known, Command(DriveMode.RUN, np.zeros(6)), 40)
    closed = [frame.id >> 5 for frame in frames if frame.id & 0x1F == 0x07]
    assert closed == [NODES[0], NODES[3]]
    assert dialogue.asked == (40, 10, 20, 40, 21, 20)
    kinds = [frame.id & 0x1F for frame in frames]
    assert kinds == [0x07, 0x0E, 0x0E, 0x0E, 0x07, 0x0E, 0x0E, 0x0E]


def test_when_run_is_over_an_axis_counts_as_enabled_until_it_says_otherwise():
    off, run, fault = int(DriveState.OFF), int(DriveState.RUN), int(DriveState.FAULT)
    start = P.start(DriveSetup(0.05, Reaction.BRAKE, 250.0))
    power = (off, run, fault, int(DriveState.BOOT), off, off)
    for before in DriveMode:
        for after in DriveMode:
            known = start._replace(mode=int(before), power=power)
            dialogue, _ = P.command(known, Command(after, np.zeros(6)), 40)
            left = before == DriveMode.RUN != after
            assert dialogue.power == ((run, run, fault, 0, run, run) if left else power)


@pytest.mark.parametrize(("heartbeat_s", "ticks"), [(None, 76), (0.001, 2), (0.0, 2), (0.0041, 4)])
def test_an_axis_is_unknown_after_three_heartbeats_that_did_not_come_and_two_ticks_at_least(
    heartbeat_s, ticks
):
    more = () if heartbeat_s is None else (heartbeat_s,)
    protocol = ODriveProtocol(NODES, 0.05, UNLIKE, *more)
    assert protocol.start(DriveSetup(0.05, Reaction.BRAKE, 251.0)).patience_ticks == ticks
    assert protocol.torque_limit == 1e4


@pytest.mark.parametrize("node", [-1, 0, 62, 63])
def test_a_node_number_is_0_to_62(node):
    nodes = (1, 2, 3, node, 5, 6)
    if node in (0, 62):
        assert ODriveProtocol(nodes, 0.05, UNLIKE).traits.emergency_stop[3].id == node << 5 | 2
        return
    with pytest.raises(ConfigurationError, match=rf"drives.node_ids\[3\]: .* 0 to 62, given: {node}"):
        ODriveProtocol(nodes, 0.05, UNLIKE)
