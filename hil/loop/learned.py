"""The learned feed-forward of a tick: when it acts, and how it comes and goes without a bump."""

from typing import NamedTuple

from drivers.arrays import ZERO6, Array
from drivers.signals import Mode
from hil.loop.motion import Motion
from hil.loop.ramps import smoothstep
from hil.trajectory.path import Trajectory


class LearnedForces(NamedTuple):
    """Leg forces over the time of one reference."""

    tau: Array
    """(n, 6) N at 0, step_s, 2 step_s ...; zero at both ends. Read-only."""
    step_s: float
    fade_s: float
    """In which they fade out and in."""

    def at(self, t: float) -> Array:
        """Return the forces (6,) N at a time t >= 0 of the reference, linear between the rows; 0 behind."""
        place = t / self.step_s
        k = int(place)
        if k + 1 >= len(self.tau):
            return ZERO6
        share = place - k
        before: Array = self.tau[k]
        return before + share * (self.tau[k + 1] - before)


class Learned:
    """The share of the learned forces that acts.

    They act in TRACKING, on the very reference that they were learned on, while its time is the clock's.
    Where the run leaves that (hold, speed, jog, park, stop), the last of them fades out, and none acts before
    the reference begins anew. After a fault none acts any more.

    Mutable state: whether a fault has struck, the tick at which TRACKING was entered, those at which the
    forces began and ended in it, and the last ones; `reset` restores the initial one.
    """

    def __init__(self, forces: LearnedForces, trajectory: Trajectory, period_s: float) -> None:
        self.forces = forces
        self._trajectory = trajectory
        self._period_s = period_s
        self.reset()

    def reset(self) -> None:
        """Back to the state before the first tick."""
        self.faulty = False
        self._entered = -1
        self._begun: int | None = None
        self._ended: int | None = None
        self._last = ZERO6

    def step(self, tick: int, mode: Mode, mode_tick: int, motion: Motion, *, faulty: bool) -> Array:
        """Return the forces (6,) N of a tick in a mode that was entered at mode_tick.

        faulty: a fault is latched.
        """
        self.faulty = self.faulty or faulty
        if mode is Mode.TRACKING and mode_tick != self._entered:
            self._entered, self._begun, self._ended = mode_tick, None, None
        acts = mode is Mode.TRACKING and motion.trajectory is self._trajectory and motion.on_clock
        if acts and not self.faulty and self._ended is None:
            return self._act(tick, mode_tick, motion)
        if self._begun is None:
            return ZERO6
        if self._ended is None:
            self._ended = tick
        left = 1.0 - self._passed(tick - self._ended + 1)
        if left <= 0.0:
            self._last = ZERO6
        return self._last * left if left > 0.0 else ZERO6

    def _act(self, tick: int, mode_tick: int, motion: Motion) -> Array:
        if self._begun is None:
            self._begun = tick
        forces = self.forces.at(motion.time(tick))
        if self._begun != mode_tick:  # the reference began below full speed
            forces = forces * self._passed(tick - self._begun)
        self._last = forces
        return forces

    def _passed(self, ticks: int) -> float:
        """Return how much of a fade is over after so many ticks, 0 .. 1."""
        return smoothstep(ticks * self._period_s / self.forces.fade_s)
