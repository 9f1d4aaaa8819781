"""Unexpected or duplicate frames for the controller: the resulting fault, and the frames it sends."""

from __future__ import annotations

import re

import numpy as np
import pytest

from drivers.arrays import Rows
from drivers.frame_array import sent_frames
from drivers.legs.protocol import TRIES, LegsProtocol
from drivers.protocol import Frame, Received
from drivers.signals import Command, DriveFault, DriveMode, DriveState, Fault, Foreign, Mode, Reaction, Warn
from hil.contracts.drives_end import reports
from hil.contracts.messages import Configure, EmergencyStop, Status
from hil.loop.report import waiting_text
from hil.signals import Operator
from tests.drivers.legs_frames import command_frames, one_feedback, opening, parse
from tests.hil.cycle_bench import PERIOD_NS, Bench, fault_text

POWERED = [Mode.LOADING, Mode.RELEASING, Mode.APPROACH, Mode.TRACKING]
OURS = LegsProtocol("fd", (1, 2, 3, 4, 5, 6), 30_000.0)
RUN = Command(DriveMode.RUN, np.full(6, 3e3))
CONTROLLERS = {
    "a SYNC": (opening(OURS, 3)[0], Foreign.SYNC),
    "a SYNC of another kind": (Frame(0x080, b""), Foreign.SYNC),
    "our own command": (command_frames(OURS, RUN, 3)[0], Foreign.COMMAND),
    "a command of another layout": (
        command_frames(LegsProtocol("classic", OURS.nodes), RUN, 3)[1],
        Foreign.COMMAND,
    ),
    "a broken command": (Frame(0x110, bytes(32)), Foreign.COMMAND),
    "a CONFIG": (OURS.configure(4000.0, Reaction.ZERO)[5], Foreign.CONFIG),
}


def heard(bench: Bench, *frames: Frame) -> tuple[Received, ...]:
    """Frames received in the next tick, followed by the given ones."""
    t_ns = (bench.tick + 1) * PERIOD_NS + 300_000
    return (*bench.drives.feedback(bench.tick + 1), *(Received(t_ns, frame) for frame in frames))


def estops(frames: Rows) -> int:
    return sum(isinstance(parse(OURS, frame), EmergencyStop) for frame in sent_frames(frames))


@pytest.fixture
def bench() -> Bench:
    return Bench()


@pytest.mark.parametrize("mode", [Mode.WAITING, Mode.IDLE, *POWERED])
def test_received_controller_frame_means_a_second_controller(mode):
    for name, (frame, kind) in CONTROLLERS.items():
        bench = Bench()
        bench.until(mode)
        out = bench.step(frames=heard(bench, frame))
        assert bench.cycle.mode is Mode.FAULT, name
        assert bench.cycle.faults == Fault.SECOND_CONTROLLER, name
        assert out.row["foreign"] == kind
        assert f"frames received from it: {kind.name}" in fault_text(bench.cycle)
        assert estops(out.frames) == (mode in POWERED), "unpowered drives must get no emergency stop"
        if mode is not Mode.APPROACH:
            break  # one of them stands for the others


@pytest.mark.parametrize("mode", [Mode.WAITING, Mode.IDLE, *POWERED])
def test_emergency_stop_of_another_node_stops_this_controller(mode):
    bench = Bench()
    bench.until(mode)
    out = bench.step(frames=heard(bench, Frame(0x001, b"\x07")))
    assert bench.cycle.faults == Fault.ESTOP
    assert estops(out.frames) == 1


def test_emergency_stop_is_repeated_until_the_last_drive_confirms(bench):
    bench.until(Mode.APPROACH)

    def told(leg: int, fault: DriveFault) -> tuple[Frame, ...]:
        holds = Configure(leg, 0.01, Reaction.BRAKE)
        return reports(OURS, Status(leg, DriveState.FAULT, fault, holds))

    sent = [estops(bench.step((Operator.ESTOP,)).frames)]
    for leg in (3, 0, 5, 1, 2):
        bench.drives.state[leg] = DriveState.FAULT
        sent.append(estops(bench.step().frames))
        bench.drives.statuses += told(leg, DriveFault.ESTOP)
        sent.append(estops(bench.step().frames))
    bench.drives.statuses += told(4, DriveFault.WATCHDOG)
    bench.drives.state[4] = DriveState.FAULT
    sent += [estops(bench.step().frames) for _ in range(50)]
    assert sent == [1] * 61
    bench.drives.statuses += told(4, DriveFault.ESTOP)
    assert [estops(bench.step().frames) for _ in range(50)] == [0] * 50
    bench.drives.state[2] = DriveState.OFF
    assert estops(bench.step().frames) == 1, "emergency stop is sent again after a drive left FAULT"


@pytest.mark.parametrize("late", [False, True])
@pytest.mark.parametrize("change", ["length", "rate", "force", "state", "invalid"])
def test_two_different_answers_to_one_sync_mean_a_duplicate_node(bench, late, change):
    bench.until(Mode.APPROACH)
    number = bench.tick + 1
    said = {"length": bench.drives.length[2], "rate": 0.0, "force": 0.0, "state": int(DriveState.RUN)}
    if change == "invalid":
        said["state"] |= 8
    else:
        said[change] += {"length": 1e-7, "rate": 1e-7, "force": 3.75, "state": -1}[change]
    twin = one_feedback(OURS, 2, said["length"], said["rate"], said["force"], int(said["state"]), number & 15)
    if late:
        bench.step()
        assert bench.cycle.faults == Fault.NONE
        out = bench.step(frames=(Received(bench.tick * PERIOD_NS + 900_000, twin), *heard(bench)))
    else:
        out = bench.step(frames=heard(bench, twin))
    assert bench.cycle.faults == Fault.DUPLICATE_NODE
    assert out.row["doubled"] == 1 << 2
    assert out.row["q"][2] == pytest.approx(bench.drives.length[2], abs=1e-7), "the first answer counts"
    assert "the node number of leg 2" in fault_text(bench.cycle)
    assert estops(out.frames) == 0


def test_repeated_identical_answer_is_accepted(bench):
    bench.until(Mode.APPROACH)
    for _ in range(40):
        frames = bench.drives.feedback(bench.tick + 1)
        row = bench.step(frames=frames + frames).row
        assert (row["doubled"], row["rejected"], bench.cycle.faults) == (0, 0, Fault.NONE)
    late = [
        Received(bench.tick * PERIOD_NS + 900_000, each.frame) for each in bench.drives.feedback(bench.tick)
    ]
    row = bench.step(frames=(*late, *bench.drives.feedback(bench.tick + 1))).row
    assert (row["doubled"], bench.cycle.faults) == (0, Fault.NONE)


def broken(frame: Frame) -> Frame:
    return frame._replace(data=frame.data[:-1] + bytes([frame.data[-1] ^ 1]))


@pytest.mark.parametrize("every", [1, 4, 5])
def test_refused_frames_in_eight_of_32_ticks_are_a_fault(bench, every):
    bench.until(Mode.APPROACH)
    bad = 0
    for k in range(64):
        frames = bench.drives.feedback(bench.tick + 1)
        if k % every == 0:
            bad += 1
            frames += (Received(frames[0].t_ns, broken(frames[3].frame)),)
        row = bench.step(frames=frames).row
        assert bool(row["warnings"] & Warn.REJECTED) == (k % every == 0)
        if bench.cycle.faults:
            break
    if every == 5:
        assert bench.cycle.faults == Fault.NONE, "7 of 32 ticks are a bad line"
    else:
        assert (bench.cycle.faults, bad) == (Fault.REFUSED_FRAMES, 8)
        assert "8 of the last 32 ticks" in fault_text(bench.cycle)


@pytest.mark.parametrize("mode", [Mode.IDLE, *POWERED])
def test_drive_that_changes_its_confirmed_set_up_is_a_fault(mode):
    bench = Bench()
    bench.until(mode)
    other = Configure(4, 4000.0, Reaction.ZERO)
    bench.drives.statuses += reports(OURS, Status(4, bench.drives.state[4], 0, other))
    out = bench.step()
    assert bench.cycle.faults == Fault.SET_UP
    assert out.row["altered"] == 1 << 4
    assert "drive 4 reports a set-up that this controller did not send" in fault_text(bench.cycle)


@pytest.mark.parametrize(
    ("wrong", "lacks"),
    [
        ("none", "reports no set-up"),
        ("watchdog", "other than the one sent"),
        ("reaction", "other than the one sent"),
        ("rated force", "drives.force_limit_N"),
        ("silent", "not confirmed"),
    ],
)
def test_run_does_not_start_until_every_drive_confirms_its_set_up(wrong, lacks):
    bench = Bench()
    obey = bench.drives.obey
    speaks = LegsProtocol("fd", OURS.nodes, 3e3) if wrong == "rated force" else bench.drives.protocol

    def obey_wrongly(frames):
        obey(frames)
        told = bench.drives.statuses
        bench.drives.statuses = [frame for frame in told if frame.id != 0x702]
        if len(told) == len(bench.drives.statuses) or wrong == "silent":
            return
        holds = {
            "watchdog": Configure(1, 0.010001, Reaction.BRAKE),
            "reaction": Configure(1, 0.01, Reaction.HOLD),
            "rated force": Configure(1, 0.01, Reaction.BRAKE),
        }.get(wrong)
        bench.drives.statuses += reports(speaks, Status(1, DriveState.OFF, 0, holds))

    bench.drives.obey = obey_wrongly  # type: ignore[method-assign]
    for _ in range(1000):
        bench.step()
    assert bench.cycle.mode is Mode.WAITING
    assert [c.leg for c in bench.drives.configured].count(1) == TRIES
    assert len(bench.drives.configured) == TRIES + 5
    text = waiting_text(bench.cycle)
    assert re.findall(r"drive (\d)", text) == ["1"]
    assert lacks in text
