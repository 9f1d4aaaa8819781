"""Ticks that come late while a watchdog is measured, as on a machine that does not keep real time."""

from collections.abc import Sequence

import pytest

from drivers.protocol import Frame
from hil.lab.bringup.drives import Heard
from hil.lab.bringup.rehearsal import BenchLine
from hil.lab.bringup.steps import scan, silence
from plant_fmu.rehearsal.wiring import Mistake, Wiring, wired
from tests.broad import broad
from tests.hil.lab.bringup.kit import Rehearsal, named

FAMILIES = ["virtual", "moteus_zero_velocity", "virtual-cia402", "odrive"]
"""Watched on shut brakes, asked, watched one at a time, told by the heartbeat."""


class Stalling(BenchLine):
    """A line whose second tick of a silence comes late, some times."""

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
    """Return what is named with ticks that are late by so many times the watchdog, and late ticks left."""
    rehearsal = Rehearsal(family, wiring)
    line = Stalling(rehearsal, late * rehearsal.machine.watchdog_s, times)
    rehearsal.drives.line = line
    return named(rehearsal.run((scan.STEP, silence.STEP))), line.times


@pytest.mark.parametrize("family", broad(FAMILIES, quick=2))
def test_what_is_said_of_a_watchdog_holds_its_true_time(family):
    for share in (0.95, 1.0):
        rehearsal = Rehearsal(
            family, wired(Mistake("watchdog_short", 2, value=share)) if share < 1.0 else Wiring()
        )
        rehearsal.run((scan.STEP, silence.STEP))
        fact = rehearsal.context.known("watchdog", 2)
        assert fact["since_s"] <= share * rehearsal.machine.watchdog_s <= fact["until_s"]


@pytest.mark.parametrize("family", broad(FAMILIES, quick=1))
def test_a_watchdog_eight_times_too_long_is_named_although_a_tick_of_its_silence_is_late(family):
    leg = 3
    assert found(family, wired(Mistake("watchdog_long", leg)), 6.5, 1) == ({("watchdog_long", (leg,))}, 0)


@pytest.mark.parametrize("family", broad(FAMILIES, quick=1))
def test_a_watchdog_that_is_right_is_measured_again_where_a_tick_was_late(family):
    assert found(family, Wiring(), 6.5, silence.TRIES - 1) == (set(), 0)


@pytest.mark.parametrize("family", broad(FAMILIES, quick=1))
def test_a_watchdog_that_late_ticks_hide_each_time_is_named_unmeasured(family):
    findings, _ = found(family, Wiring(), 6.5, 100)
    assert findings == {("watchdog_unmeasured", (leg,)) for leg in range(6)}
