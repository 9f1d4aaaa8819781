"""Late ticks and answers; one tick per period on a bus, with all frames of its window."""

from collections.abc import Sequence
from typing import Any, cast

import pytest

from drivers.arrays import Rows
from drivers.can.bus import Bus, BusEvents
from drivers.clock import Clock
from drivers.errors import BusError
from drivers.frame_array import received_array, sent_frames
from drivers.protocol import Frame, Received
from hil.lab.bringup.connection import BusLine
from hil.lab.bringup.drives import Heard
from hil.lab.bringup.rehearsal import BenchLine
from hil.lab.bringup.steps import scan, silence
from plant_fmu.rehearsal.wiring import Mistake, Wiring, wired
from tests.broad import broad
from tests.hil.lab.bringup.rehearsals import Rehearsal, named

FAMILIES = ["virtual", "moteus_zero_velocity", "virtual-cia402", "odrive"]
"""How the power state is found: watched on shut brakes, polled, watched one at a time, by heartbeat."""


class Stalling(BenchLine):
    """A line on which the second tick of a silence comes late, `times` times."""

    def __init__(self, rehearsal: Rehearsal, late_s: float, times: int) -> None:
        super().__init__(rehearsal.bench.nodes, rehearsal.drives.line.rate_Hz)
        self._polled = rehearsal.drives.protocol.traits.command_delay_ticks > 0
        self._late = round(late_s * self.rate_Hz)
        self.times = times
        self._silent = 0

    def exchange(self, opening: Sequence[Frame]) -> Heard:
        if self._silent == 1 and self.times:
            self._tick += self._late
            self.times -= 1
        if self._polled:
            self._count(opening)
        return super().exchange(opening)

    def send(self, frames: Sequence[Frame]) -> None:
        if not self._polled:
            self._count(frames)
        super().send(frames)

    def _count(self, commands: Sequence[Frame]) -> None:
        self._silent = 0 if commands else self._silent + 1


def found(
    family: str, wiring: Wiring, late: float, times: int
) -> tuple[set[tuple[str, tuple[int, ...]]], int]:
    """Findings with ticks late by this multiple of the watchdog, and the late ticks left over."""
    rehearsal = Rehearsal(family, wiring)
    line = Stalling(rehearsal, late * rehearsal.machine.watchdog_s, times)
    rehearsal.drives.line = line
    return named(rehearsal.run((scan.STEP, silence.STEP))), line.times


@pytest.mark.parametrize("family", broad(FAMILIES, quick=1))
def test_too_long_watchdog_is_found_despite_a_late_tick(family):
    leg = 3
    assert found(family, wired(Mistake("watchdog_long", leg)), 6.5, 1) == ({("watchdog_long", (leg,))}, 0)


@pytest.mark.parametrize("family", broad(FAMILIES, quick=1))
def test_correct_watchdog_is_measured_again_after_a_late_tick(family):
    assert found(family, Wiring(), 6.5, silence.TRIES - 1) == (set(), 0)


@pytest.mark.parametrize("family", broad(FAMILIES, quick=1))
def test_watchdog_is_reported_as_unmeasured_if_every_attempt_has_late_ticks(family):
    findings, _ = found(family, Wiring(), 6.5, 100)
    assert findings == {("watchdog_unmeasured", (leg,)) for leg in range(6)}


class AfterSilence:
    """Delays the first answers after a silence into the next tick."""

    def __init__(self) -> None:
        self._silent, self._late = False, tuple[Received, ...]()

    def __call__(self, heard: Heard, opening: Sequence[Frame]) -> Heard:
        frames = (*self._late, *heard.frames)
        self._late = heard.frames if self._silent and opening else ()
        self._silent = not opening
        return Heard(heard.since_ns, frames[: -len(self._late)] if self._late else frames)


@pytest.mark.parametrize(
    ("wiring", "findings"),
    [
        (Wiring(), set()),
        (wired(Mistake("watchdog_missing", 2)), {("watchdog_missing", (2,))}),
    ],
    ids=["good", "missing"],
)
def test_watchdog_is_measured_although_an_answer_is_late(wiring, findings):
    rehearsal = Rehearsal("moteus_zero_velocity", wiring)
    rehearsal.hears(AfterSilence())
    assert named(rehearsal.run((scan.STEP, silence.STEP))) == findings


POLL, ANSWER, LATE = Frame(1, b"p"), Frame(2, b"a"), Frame(3, b"l")


class Waited(Clock):
    """A clock that advances only while somebody waits for it."""

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


def test_bus_tick_returns_the_answers_of_its_window_and_late_answers_of_the_previous_tick():
    bus = FakeBus()
    line = BusLine(cast("Bus", bus), 500.0, 1.3e-3, watched=True)
    first, second = line.exchange([POLL]), line.exchange([POLL])
    assert [r.frame for r in first.frames] == [ANSWER]
    assert [r.frame for r in second.frames] == [LATE, ANSWER]
    assert second.frames[0].t_ns < second.since_ns <= second.frames[1].t_ns
    assert second.since_ns - first.since_ns == 2_000_000


def test_bus_tick_reports_how_long_the_virtual_clock_paused_before_it():
    bus = FakeBus()
    bus.clock.stood_ns = 100
    line = BusLine(cast("Bus", bus), 500.0, 1.3e-3, watched=True)
    stood = []
    for more_ns in (0, 7_000_000, 0):
        bus.clock.stood_ns += more_ns
        stood.append(line.exchange([POLL]).stretched_ns)
    assert stood == [0, 7_000_000, 0]


@pytest.mark.parametrize(("watched", "left"), [(True, "watchdogs shut"), (False, "cut their power now")])
def test_bus_off_ends_the_bring_up_and_reports_the_state_of_the_drives(watched, left):
    bus = FakeBus()
    line = BusLine(cast("Bus", bus), 500.0, 1.3e-3, watched=watched)
    bus.off = True
    with pytest.raises(BusError, match=f"down: the drives.* {left}"):
        line.exchange([])
