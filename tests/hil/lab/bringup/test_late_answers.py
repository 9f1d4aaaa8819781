"""Answers that come a tick late, as over an adapter or from a machine that was held up."""

from collections.abc import Sequence

import pytest

from drivers.protocol import Frame, Received
from hil.lab.bringup.drives import Heard, Line
from hil.lab.bringup.steps import scan, silence
from plant_fmu.rehearsal.wiring import Mistake, Wiring, wired
from tests.hil.lab.bringup.kit import Rehearsal, named


class AfterSilence:
    """A line on which the first answers after a silence miss their window: they stand in the next tick."""

    def __init__(self, line: Line) -> None:
        self.rate_Hz, self._line = line.rate_Hz, line
        self._silent, self._late = False, tuple[Received, ...]()

    def exchange(self, opening: Sequence[Frame]) -> Heard:
        heard = self._line.exchange(opening)
        frames = (*self._late, *heard.frames)
        self._late = heard.frames if self._silent and opening else ()
        self._silent = not opening
        return Heard(heard.since_ns, frames[: -len(self._late)] if self._late else frames)

    def send(self, frames: Sequence[Frame]) -> None:
        self._line.send(frames)


@pytest.mark.parametrize(
    ("wiring", "findings"),
    [
        (Wiring(), set()),
        (wired(Mistake("watchdog_missing", 2)), {("watchdog_missing", (2,))}),
    ],
    ids=["good", "missing"],
)
def test_a_watchdog_is_proven_although_the_first_answer_after_a_silence_is_late(wiring, findings):
    rehearsal = Rehearsal("moteus_zero_velocity", wiring)
    rehearsal.drives.line = AfterSilence(rehearsal.drives.line)
    assert named(rehearsal.run((scan.STEP, silence.STEP))) == findings
