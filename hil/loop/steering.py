"""Set-points on their way into motion: which are taken, which are refused, and why."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from drivers.arrays import Array
from drivers.compiled.pointed import Callee
from drivers.signals import Refusal
from hil.signals import SetPoint
from hil.trajectory.live import LiveTrajectory


class Counts(NamedTuple):
    """How many set-points have been taken and refused so far, and why in this tick."""

    taken: int
    refused: int
    refusal: int


NO_SETPOINTS = Counts(0, 0, 0)


class Steering:
    """Sends a live trajectory where the set-points ask it to go.

    Mutable state: the trajectory's own, the counts, and the answers to the set-points of the last tick.
    `reset` restores the initial one.
    """

    def __init__(self, trajectory: LiveTrajectory, admission: Callable[[Array], int], judge: Callee) -> None:
        """Take the judge of poses (6,) m, rad: bits of Refusal against them; see `hil.loop.admission`.

        judge: the same by address, see `LiveTrajectory.advance`.
        """
        self.trajectory = trajectory
        self._admission, self.judge = admission, judge
        self.reset()

    def reset(self) -> None:
        """Back to the start, with nothing counted."""
        self.trajectory.reset()
        self.counts = NO_SETPOINTS
        self.answers: list[int] = []
        """Bits of Refusal for each set-point of the last tick, in their order."""

    def take(self, setpoints: Sequence[SetPoint], *, tracking: bool) -> None:
        """Take this tick's set-points: only while `tracking`; of several good ones the last is followed."""
        taken, refused, refusal = self.counts
        refusal = 0
        if setpoints or self.answers:
            self.answers = []
        for setpoint in setpoints:
            chi = np.array(setpoint)
            against = self._admission(chi) if tracking else int(Refusal.NOT_TRACKING)
            self.answers.append(against)
            refusal |= against
            if against:
                refused += 1
            else:
                taken += 1
                self.trajectory.aim(chi)
        self.counts = Counts(taken, refused, refusal)

    def stopped(self, against: int) -> None:
        """Count a stop on the way, with what was found against it."""
        taken, refused, refusal = self.counts
        self.counts = Counts(taken, refused + 1, refusal | against | int(Refusal.ON_THE_WAY))

    @property
    def tells(self) -> bool:
        """Whether the next tick has to take back what this one says."""
        return bool(self.counts.refusal or self.answers)
