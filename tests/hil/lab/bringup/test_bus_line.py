"""The bring-up's line on a bus: one tick a period, all frames of the window, and a bus that is down."""

from typing import Any, cast

import pytest

from drivers.arrays import Rows
from drivers.can.bus import Bus, BusEvents
from drivers.clock import Clock
from drivers.errors import BusError
from drivers.frame_array import received_array, sent_frames
from drivers.protocol import Frame, Received
from hil.lab.bringup.ends import BusLine

POLL, ANSWER, LATE = Frame(1, b"p"), Frame(2, b"a"), Frame(3, b"l")


class Waited(Clock):
    """Time that passes when somebody waits for it."""

    def __init__(self) -> None:
        self.t_ns = 1_000_000
        self.allowed_ns = self.stood_ns = 0

    def now(self) -> int:
        return self.t_ns

    def sleep_until(self, t_ns: int, spin_ns: int = 0) -> None:
        del spin_ns
        self.t_ns = max(self.t_ns, t_ns)

    def working(self, allowed_ns: int = 0) -> None:
        self.allowed_ns = allowed_ns

    def stretched(self) -> int:
        return self.stood_ns


class FakeBus:
    """Answers each poll after 0.3 ms, and once more 1.6 ms later."""

    def __init__(self) -> None:
        self.clock, self.off = Waited(), False
        self.due: list[Received] = []
        self.sent: list[Frame] = []

    def flush_tx(self) -> None:
        self.due = []

    def send(self, frames: Any) -> int:
        for frame in sent_frames(frames):
            self.sent.append(frame)
            now = self.clock.t_ns
            self.due += [Received(now + 300_000, ANSWER), Received(now + 1_900_000, LATE)]
        return 0

    def drain_now(self) -> Rows:
        here = [r for r in self.due if r.t_ns <= self.clock.t_ns]
        self.due = [r for r in self.due if r.t_ns > self.clock.t_ns]
        return received_array(here)

    def wait(self, deadline_ns: int) -> Rows:
        self.clock.t_ns = min([deadline_ns, *(r.t_ns for r in self.due)])
        return self.drain_now()

    def events(self) -> BusEvents:
        return BusEvents(0, self.off, 0)


def test_a_tick_has_the_answers_of_its_window_and_what_was_late_before():
    bus = FakeBus()
    line = BusLine(cast("Bus", bus), 500.0, 1.3e-3, watched=True)
    first, second = line.exchange([POLL]), line.exchange([POLL])
    assert [r.frame for r in first.frames] == [ANSWER]
    assert [r.frame for r in second.frames] == [LATE, ANSWER]
    assert second.frames[0].t_ns < second.since_ns <= second.frames[1].t_ns
    assert second.since_ns - first.since_ns == 2_000_000


def test_a_tick_waits_as_long_as_its_window():
    bus = FakeBus()
    line = BusLine(cast("Bus", bus), 500.0, 1.95e-3, watched=True)
    assert [r.frame for r in line.exchange([POLL]).frames] == [ANSWER, LATE]


def test_what_the_window_leaves_of_a_period_is_for_computing():
    bus = FakeBus()
    BusLine(cast("Bus", bus), 500.0, 1.3e-3, watched=True).exchange([POLL])
    assert bus.clock.allowed_ns == 700_000


def test_a_tick_says_for_how_long_time_stood_still_before_it():
    bus = FakeBus()
    bus.clock.stood_ns = 100
    line = BusLine(cast("Bus", bus), 500.0, 1.3e-3, watched=True)
    stood = []
    for more_ns in (0, 7_000_000, 0):
        bus.clock.stood_ns += more_ns
        stood.append(line.exchange([POLL]).stretched_ns)
    assert stood == [0, 7_000_000, 0]


@pytest.mark.parametrize(("watched", "left"), [(True, "watchdogs shut"), (False, "cut their power now")])
def test_a_bus_that_is_down_ends_the_bring_up_and_says_what_the_drives_do(watched, left):
    bus = FakeBus()
    line = BusLine(cast("Bus", bus), 500.0, 1.3e-3, watched=watched)
    bus.off = True
    with pytest.raises(BusError, match=f"down: the drives.* {left}"):
        line.exchange([])
