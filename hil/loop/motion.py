"""The platform's present path and the place on it, as kernels and as the class `Motion`."""

from math import inf, nan
from typing import Any

import numpy as np

from drivers.arrays import Array
from drivers.compiled.compiler import INTEGER, REAL, helper, kernel, record
from drivers.compiled.pointed import Callee, address_of, call
from hil.trajectory.live import LiveTrajectory
from hil.trajectory.override import OVERRIDE, Override, go_on, is_full, is_resting, looked_ahead, time_at
from hil.trajectory.path import SAMPLE, HoldTrajectory, PoseSample, Trajectory, callee_of, of_record, require
from hil.trajectory.stopping import StoppingTrajectory, slow

MOTION = np.dtype(
    [
        ("function", "<i8"),
        ("context", "<i8"),
        ("duration", "<f8"),
        ("stopped", "<i8"),
        ("then_function", "<i8"),
        ("then_context", "<i8"),
    ]
)
"""The trajectory's function and its context, its length in s (inf without an end), the tick at which a stop
from less than full speed came to rest; function and context of the next trajectory, 0 without one."""
ENDED, OVERDUE = 1, 2
NO_STOP, SLOWS = -2, -1
"""Values of `stopped`: no such stop; still slowing down."""


@helper
def along(function: int, context: int, t: float, sigma: float, dsigma: float, sample: Any) -> int:
    """Fill in a path's sample at path time t, s, speed share sigma, dsigma 1/s; returns its status."""
    status: int = call(function, (context, t, address_of(sample)))
    if sigma != 1.0 or dsigma != 0.0:
        slow(sample, sigma, dsigma)
    return status


@helper
def place_reference(override: Any, function: int, context: int, tick: int, sample: Any) -> int:
    """Fill in the reference sample of a tick, at the present speed share; returns the path's status."""
    t = time_at(override, tick)
    return along(function, context, t, override.sigma, override.dsigma, sample)


@helper
def advance(motion: Any, override: Any, tick: int) -> None:
    """Advance speed share and path time to a tick."""
    go_on(override, tick)
    if motion.stopped == SLOWS and is_resting(override):
        motion.stopped = tick


@helper
def ended(motion: Any, override: Any, tick: int) -> bool:
    """True if the present trajectory has ended."""
    if motion.stopped != NO_STOP:
        return bool(0 <= motion.stopped <= tick)
    return bool(time_at(override, tick) >= motion.duration)


@helper
def overdue(motion: Any, override: Any, tick: int, patience: float) -> bool:
    """True if the present trajectory ended more than `patience`, s, ago."""
    if motion.stopped != NO_STOP:
        late = (tick - motion.stopped) * override.period > patience
        return bool(late and ended(motion, override, tick))
    return bool(time_at(override, tick) > motion.duration + patience)


@helper
def ticks_left(motion: Any, override: Any, tick: int) -> int:
    """Ticks until the present trajectory ends if the speed is full; 0 after its end.

    For a trajectory with an end. Counted in path time: a hold on the way delays the end.
    """
    ticks = max(int((motion.duration - time_at(override, tick)) / override.period), 0)
    while time_at(override, tick + ticks) < motion.duration:
        ticks += 1
    return ticks


@helper
def ahead(motion: Any, override: Any, tick: int, s: float, sample: Any) -> tuple[int, float]:
    """Fill in the reference sample `s` seconds after a tick.

    Returns (status, time along the next trajectory, s: nan unless that one starts within the `s` seconds).
    """
    function, context = motion.function, motion.context
    if not is_full(override):
        t, sigma, dsigma = looked_ahead(override, tick, s)
        return along(function, context, t, sigma, dsigma, sample), nan
    if motion.then_function != 0 and motion.duration < inf and not ended(motion, override, tick):
        t = s - ticks_left(motion, override, tick) * override.period
        if t >= 0.0:
            return along(motion.then_function, motion.then_context, t, 1.0, 0.0, sample), t
    return along(function, context, time_at(override, tick) + s, 1.0, 0.0, sample), nan


@kernel(record(MOTION), record(OVERRIDE), INTEGER, record(SAMPLE))
def sample_at(motion: Any, override: Any, tick: int, sample: Any) -> int:
    """Fill in the sample of the motion at a tick; returns the path's status."""
    return place_reference(override, motion.function, motion.context, tick, sample)


@kernel(record(MOTION), record(OVERRIDE), INTEGER, REAL)
def end(motion: Any, override: Any, tick: int, patience: float) -> int:
    """State of the trajectory: 0 before its end, then ENDED, and OVERDUE `patience` s later."""
    if overdue(motion, override, tick, patience):
        return OVERDUE
    return ENDED if ended(motion, override, tick) else 0


advance_to = kernel(record(MOTION), record(OVERRIDE), INTEGER)(advance)
"""`advance` for Python."""


class Motion:
    """The present trajectory, the tick of its time zero, and the speed along it.

    A trajectory with state from tick to tick (`LiveTrajectory`) is not slowed down along its path: it has a
    speed of its own. Mutable state: all of these, the next trajectory, and a path that was left for another
    one, with the time along it. `start`, `rest` and `stop` replace the trajectory and forget the left path.
    `record`, a MOTION, holds the part that compiled code needs.
    """

    def __init__(self, period_s: float, p: Array, R: Array, change_s: float) -> None:
        """Start at rest at p (3,) m, R (3, 3), base frame; change_s: duration of a speed change, s."""
        self.period_s = period_s
        self.override = Override(period_s, change_s)
        self.record = np.zeros((), MOTION)
        self.rest(p, R, 0)

    def start(self, trajectory: Trajectory, tick: int, then: Trajectory | None = None) -> None:
        """Start a trajectory at time zero in this tick; `then`: the trajectory that follows at its end."""
        self.tick = tick
        self._go_along(trajectory)
        self.override.begin(tick)
        if isinstance(trajectory, LiveTrajectory):
            self.override.settle(tick, 1.0)
        self.record["stopped"] = NO_STOP
        self._expect(then)
        self._left: tuple[Trajectory, float] | None = None

    def _go_along(self, trajectory: Trajectory) -> None:
        self.trajectory = trajectory
        self._callee = callee_of(trajectory)
        duration = trajectory.duration_s
        self.record["function"], self.record["context"] = self._callee[:2]
        self.record["duration"] = inf if duration is None else duration

    def _expect(self, then: Trajectory | None) -> None:
        self.then = then
        self._next = Callee(0, 0, None) if then is None else callee_of(then)
        self.record["then_function"], self.record["then_context"] = self._next[:2]

    def rest(self, p: Array, R: Array, tick: int) -> None:
        """Stay at the pose p (3,) m, R (3, 3), base frame, from this tick on."""
        self.start(HoldTrajectory(p, R), tick)

    def leave(self, trajectory: Trajectory, tick: int) -> None:
        """Leave the present path, at rest, for another trajectory; `resume` returns to the path later."""
        left = self._left or (self.trajectory, self.time(tick))
        self.start(trajectory, tick)
        self._left = left
        self.override.settle(tick, 0.0)

    def resume(self, tick: int) -> None:
        """Return to the path that was left, at rest at the same place."""
        assert self._left is not None
        trajectory, s = self._left
        self.start(trajectory, tick)
        self.override.place(tick, s)

    @property
    def left(self) -> tuple[PoseSample, float] | None:
        """Place where the path was left: (sample at rest, time along it, s); None while on the path."""
        if self._left is None:
            return None
        trajectory, s = self._left
        sample = trajectory.sample(s)
        return PoseSample(sample.p, sample.R, np.zeros(6), np.zeros(6)), s

    @property
    def away(self) -> bool:
        """True while the platform is off a path to which `resume` returns."""
        return self._left is not None

    def aim(self, tick: int, speed: float, *, go: bool) -> None:
        """Change the speed smoothly to a share, 0 .. 1, of the configured one; without `go` to rest."""
        if isinstance(self.trajectory, LiveTrajectory):
            self.trajectory.limit(speed)
            if not go:
                self.trajectory.halt()
        else:
            self.override.aim(tick, speed if go else 0.0)

    def settle(self, tick: int, speed: float) -> None:
        """Set the speed at once to a share, 0 .. 1, of the configured one."""
        if not isinstance(self.trajectory, LiveTrajectory):
            self.override.settle(tick, speed)

    def advance(self, tick: int) -> None:
        """Advance speed share and path time to a tick."""
        advance_to(self.record, self.override.record, tick)

    def stop(self, tick: int, duration_s: float) -> None:
        """Slow down to rest along the present path within `duration_s`; a live trajectory by its own limits.

        While the speed is still rising, it takes up to a third longer.
        """
        self._expect(None)
        self._left = None
        if isinstance(self.trajectory, LiveTrajectory):
            self.trajectory.brake()
            self._go_along(self.trajectory)
        elif self.override.full:
            self._go_along(StoppingTrajectory(self.trajectory, self.time(tick), duration_s))
        else:
            self.override.aim(tick, 0.0)
            self.record["stopped"] = tick if self.override.resting else SLOWS

    def time(self, tick: int) -> float:
        """Path time along the present trajectory in a tick, s."""
        return self.override.time(tick)

    @property
    def resting(self) -> bool:
        """True while the reference is at rest and stays there until a command moves it."""
        if isinstance(self.trajectory, LiveTrajectory):
            return self.trajectory.resting
        return self.override.resting

    def finished(self, tick: int) -> bool:
        """True if the present trajectory has ended."""
        return end(self.record, self.override.record, tick, 0.0) != 0

    def overdue(self, tick: int, patience_s: float) -> bool:
        """True if the present trajectory ended more than `patience_s`, s, ago."""
        return end(self.record, self.override.record, tick, patience_s) == OVERDUE

    def sample(self, tick: int) -> PoseSample:
        """Reference sample of a tick: pose, twist, acceleration."""
        into = np.ndarray((), SAMPLE)
        require(sample_at(self.record, self.override.record, tick, into), self._callee)
        return of_record(into)
