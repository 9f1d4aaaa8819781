"""Which path the platform is on, and where along it."""

from drivers.arrays import Array
from hil.trajectory.holding import HoldTrajectory
from hil.trajectory.live import LiveTrajectory
from hil.trajectory.path import PoseSample, Trajectory
from hil.trajectory.stopping import StoppingTrajectory


class Motion:
    """The present trajectory and the tick of its time zero.

    Mutable state: both, and what comes next. `start`, `rest` and `stop` replace them.
    """

    def __init__(self, period_s: float, p: Array, R: Array) -> None:
        """Start at rest at p (3,) m, R (3, 3), base frame."""
        self.period_s = period_s
        self.rest(p, R, 0)

    def start(self, trajectory: Trajectory, tick: int, then: Trajectory | None = None) -> None:
        """Begin a trajectory whose time zero is this tick, `then` another one as soon as it has ended."""
        self.trajectory = trajectory
        self.tick = tick
        self._then = then
        self._last = 0
        """Length of the trajectory in whole periods: the first tick at which `finished` is true."""
        if then is not None and trajectory.duration_s is not None:
            self._last = int(trajectory.duration_s / self.period_s)
            while self._last * self.period_s < trajectory.duration_s:
                self._last += 1

    def rest(self, p: Array, R: Array, tick: int) -> None:
        """Stay at a pose from this tick on."""
        self.start(HoldTrajectory(p, R), tick)

    def stop(self, tick: int, duration_s: float) -> None:
        """Slow down to rest along the present path within `duration_s`; a live one within its own limits."""
        if isinstance(self.trajectory, LiveTrajectory):
            self.trajectory.brake()
            return
        self.trajectory = StoppingTrajectory(self.trajectory, self.time(tick), duration_s)
        self._then = None

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

    def ahead(self, tick: int, s: float) -> tuple[PoseSample, float | None]:
        """Return where the platform should be `s` seconds after this tick, and that time along `then`.

        The time is None unless the next trajectory has begun by then. It is expected to begin at the first
        tick at which the present one has ended; where that has passed, it is waited for.
        """
        if self._then is not None and not self.finished(tick):
            along = (tick - self.tick - self._last) * self.period_s + s
            if along >= 0.0:
                return self._then.sample(along), along
        return self.trajectory.sample(self.time(tick) + s), None
