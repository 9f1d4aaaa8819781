"""Which path the platform is on, and where along it.

Rule of the room: time comes as tick numbers; no clock, no measurement.
"""

from __future__ import annotations

from hil.signals import Array
from hil.trajectory import PoseSample, StoppingTrajectory, Trajectory, hold


class Motion:
    """The present trajectory and the tick of its time zero.

    Mutable state: both. `start`, `rest` and `stop` replace them.
    """

    def __init__(self, period_s: float, p: Array, R: Array) -> None:
        """Start at rest at p (3,) m, R (3, 3), base frame."""
        self.period_s = period_s
        self.rest(p, R, 0)

    def start(self, trajectory: Trajectory, tick: int) -> None:
        """Begin a trajectory whose time zero is this tick."""
        self.trajectory = trajectory
        self.tick = tick

    def rest(self, p: Array, R: Array, tick: int) -> None:
        """Stay at a pose from this tick on."""
        self.start(hold(p, R), tick)

    def stop(self, tick: int, duration_s: float) -> None:
        """Slow down to rest along the present path within `duration_s`."""
        self.trajectory = StoppingTrajectory(self.trajectory, self.time(tick), duration_s)

    def time(self, tick: int) -> float:
        """Return the time along the present trajectory, s."""
        return (tick - self.tick) * self.period_s

    def finished(self, tick: int) -> bool:
        """Tell whether the present trajectory has ended."""
        duration = self.trajectory.duration_s
        return duration is not None and self.time(tick) >= duration

    def overdue(self, tick: int, patience_s: float) -> bool:
        """Tell whether the present trajectory ended longer than `patience_s` ago."""
        duration = self.trajectory.duration_s
        return duration is not None and self.time(tick) > duration + patience_s

    def sample(self, tick: int) -> PoseSample:
        """Return where the platform should be at this tick."""
        return self.trajectory.sample(self.time(tick))
