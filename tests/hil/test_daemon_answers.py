"""The daemon waits for six valid answers, and switches drives off with SYNC and command."""

from __future__ import annotations

from copy import copy
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from drivers.arrays import Rows
from drivers.can.bus import Bus
from drivers.errors import BusError
from drivers.frame_array import received_array, sent_frames
from drivers.protocol import Frame, Received
from drivers.signals import Command, DriveMode, DriveState
from hil.app.compose import build_cycle
from hil.app.configuration.configuration import load, loads
from hil.contracts.drives_end import answers
from hil.contracts.messages import DeviceCommand, Sync, hear
from hil.loop.clock import Deadlines
from hil.loop.daemon import Shell, _answers, run, switch_off
from hil.loop.panel import OperatorPanel
from hil.loop.run_end import Course
from plant_fmu.drives import drives_end
from tests.drivers.received_frames import got

TICK = 1003


class Queue:
    """A bus that delivers its frames one by one, each after the previous one was taken."""

    clock = SimpleNamespace(now=lambda: 9_000, stretched=lambda: 0)

    def __init__(self, *frames: Frame) -> None:
        self.left = [Received(5_000 + k, frame) for k, frame in enumerate(frames)]
        self.sent: list[Frame] = []
        self.over = False

    def drain(self, _deadline_ns: int, wanted: frozenset[int]) -> Rows:
        assert not self.over, "the loop must not wait again after the deadline"
        taken, missing = [], set(wanted)
        while self.left and missing:
            taken.append(self.left.pop(0))
            missing.discard(taken[-1].frame.id)
        self.over = not taken
        return received_array(taken)

    def flush_tx(self) -> None:
        """The transmit queue is empty."""

    def events(self) -> Any:
        return SimpleNamespace(off=0)

    def send(self, frames: Rows) -> int:
        self.sent += sent_frames(frames)
        return 0


@pytest.fixture(scope="module")
def cycle() -> Any:
    return build_cycle(load("virtual"), 1000.0, 0.01)


def six(cycle: Any, counter: int = TICK) -> list[Frame]:
    q, zero = np.full(6, 1.5), np.zeros(6)
    sent = answers(cycle.parts.protocol, Sync(counter), q, zero, zero, np.full(6, DriveState.RUN, np.int64))
    return [frame for _, frame in sent]


def listened(cycle: Any, bus: Queue, begun_ns: int, deadline_ns: int) -> list[Received]:
    """Frames that the daemon received in a tick."""
    return got(_answers(cycle, cast("Bus", bus), TICK, begun_ns, deadline_ns))


def commands(cycle: Any, bus: Queue) -> list[DeviceCommand]:
    """Commands of the drives in the frames sent."""
    end = drives_end(cycle.parts.protocol)
    return [each for frame in bus.sent for each in hear(end, frame) if isinstance(each, DeviceCommand)]


def damaged(frame: Frame) -> Frame:
    return frame._replace(data=bytes([frame.data[0] ^ 4]) + frame.data[1:])


@pytest.mark.parametrize("bad", [1, 2, 5])
@pytest.mark.parametrize("how", ["damaged", "old", "short"])
def test_invalid_drive_answer_does_not_end_the_wait_for_the_valid_one(cycle, bad, how):
    good = six(cycle)
    worse = {
        "damaged": damaged(good[3]),
        "old": six(cycle, TICK - 1)[3],
        "short": good[3]._replace(data=b""),
    }[how]
    bus = Queue(*good[:3], *[worse] * bad, *good[4:], good[3], damaged(good[0]))
    heard = listened(cycle, bus, 1_000, 10**9)
    assert [each.frame for each in heard] == [*good[:3], *[worse] * bad, *good[4:], good[3]]
    assert len(bus.left) == 1, "a frame after six valid answers must stay for the next tick"


def test_loop_continues_at_the_deadline_with_the_drive_answers_received_so_far(cycle):
    good = six(cycle)
    heard = listened(cycle, Queue(*good[:5], damaged(good[5])), 1_000, 10**9)
    assert len(heard) == 6


def test_drive_answers_received_before_a_stall_past_the_deadline_are_used(cycle):
    """For a family with shared identifiers the daemon waits frame by frame."""

    class HeldUp(Queue):
        def wait(self, _deadline_ns: int) -> Rows:
            return received_array([self.left.pop(0)])

        def drain_now(self) -> Rows:
            taken, self.left = self.left, []
            return received_array(taken)

    good, own = six(cycle), cycle.parts.protocol
    shared = copy(own)
    shared.traits = replace(own.traits, shares_identifiers=True)
    one: Any = SimpleNamespace(parts=SimpleNamespace(protocol=shared))
    heard = listened(one, HeldUp(*good), 1_000, 8_000)
    assert [each.frame for each in heard] == good


def test_frame_received_before_the_tick_is_not_taken_as_a_drive_answer(cycle):
    good = six(cycle)
    heard = listened(cycle, Queue(*good, *good), 5_003, 10**9)
    assert len(heard) == 9


@pytest.mark.parametrize("last", [-1, 0, 6])
def test_command_counter_continues_after_the_last_tick_while_drives_are_switched_off(cycle, last):
    bus, ended = Queue(), SimpleNamespace(tick=last, period_ns=1_000)
    assert switch_off(cycle, cast("Bus", bus), cast("Deadlines", ended))
    assert [each.counter for each in commands(cycle, bus)] == [last + k for k in range(1, 6)]


def test_switching_off_never_repeats_the_last_force_with_a_poll():
    desktop = build_cycle(load("desktop"), 400.0, 0.013)
    bus = Queue()
    assert desktop.parts.protocol.traits.command_delay_ticks == 1
    desktop.end.give(Command(DriveMode.RUN, np.full(6, 5.0)), 6)
    ended = SimpleNamespace(tick=6, period_ns=1_000)
    assert switch_off(desktop, cast("Bus", bus), cast("Deadlines", ended))
    heard = commands(desktop, bus)
    assert len(heard) == 5 * 6
    assert {each.mode for each in heard} == {DriveMode.OFF}


class Dead(Queue):
    """A bus that accepts no frame."""

    def send(self, frames: Rows) -> int:
        return len(frames)


@pytest.mark.parametrize(
    ("name", "changes", "left"),
    [
        ("virtual", (), "watchdog of each acts 13 ms after"),
        (
            "desktop",
            ("{variant: damiao, model: DM4310}", "{variant: cubemars, model: AK80-9}"),
            "they keep the last torque; cut their power now",
        ),
    ],
)
def test_a_dead_bus_reports_the_watchdog_only_for_drives_that_have_one(name, changes, left):
    text = load(name).text
    c = loads(text.replace(*changes), name) if changes else load(name)
    cycle, bus = build_cycle(c, 400.0, 0.013), Dead()

    def wait() -> Any:
        raise BusError("the interface is gone")

    deadlines = SimpleNamespace(tick=7, period_ns=1_000, wait=wait)
    recording = SimpleNamespace(alive=True)
    shell = Shell(cast("Any", bus), cast("Any", deadlines), cast("Any", recording), OperatorPanel(), 0)
    ending = run(Course(cycle), shell)
    assert ending.trouble.startswith("tick 7: the interface is gone")
    assert "command to switch off could not be sent" in ending.trouble
    assert left in ending.trouble
