"""The learned feed-forward of a tick: when it acts, and how it comes and goes without a bump."""

from typing import NamedTuple

import numpy as np

from drivers.arrays import ZERO6, Array
from drivers.signals import Mode
from hil.loop.motion import Motion
from hil.loop.ramps import smoothstep
from hil.trajectory.path import Trajectory


class LearnedForces(NamedTuple):
    """Leg forces over the time of one reference, and over the last of the way to its start."""

    tau: Array
    """(n, 6) N at start_s, start_s + step_s, ... Read-only."""
    start_s: float
    """At most 0: time before the reference begins."""
    step_s: float
    fade_s: float
    """In which they fade in and out."""

    def at(self, t: float) -> Array:
        """Return the forces (6,) N at a time of the reference, linear between the rows; the last one behind.

        t: s, not before start_s.
        """
        last = len(self.tau) - 2
        place = min((t - self.start_s) / self.step_s, last + 1.0)
        k = min(int(place), last)
        before, after = self.tau[k], self.tau[k + 1]
        return np.asarray(before + (place - k) * (after - before), np.float64)


class Learned:
    """The share of the learned forces that acts.

    They act on the very reference that they were learned on, and on the last of the way to its start, while
    path time is the clock's. Where TRACKING leaves that (hold, speed, jog, park, stop), the last of them
    fades out, and none acts before the reference begins anew. At the reference's end the last one stays until
    the brakes are shut, and goes with the holding force. After a fault none acts any more.

    Mutable state: whether a fault has struck, whether the present way along the reference has been left, and
    the forces with their share, 0 .. 1; `reset` restores the initial one.
    """

    def __init__(self, forces: LearnedForces, trajectory: Trajectory, period_s: float) -> None:
        self.forces = forces
        self._trajectory = trajectory
        self._step = period_s / forces.fade_s
        self.reset()

    def reset(self) -> None:
        """Back to the state before the first tick."""
        self._faulty = self._acts = self._left = False
        self._share = 0.0
        self._tau = ZERO6

    def step(self, tick: int, mode: Mode, mode_tick: int, motion: Motion, *, faulty: bool) -> Array:
        """Return the forces (6,) N of a tick in a mode that was entered at mode_tick.

        faulty: a fault is latched.
        """
        self._faulty = self._faulty or faulty
        if tick == mode_tick and mode in {Mode.APPROACH, Mode.TRACKING}:
            self._left = False
        t = self._time(tick, mode, motion)
        if t is not None and (self._acts or self._share == 0.0):
            self._acts = True
            self._share = min(self._share + self._step, 1.0)
            self._tau = self.forces.at(t)
        elif mode is not Mode.PARKING or self._faulty:
            self._left = self._left or (self._acts and mode is Mode.TRACKING and tick != mode_tick)
            self._acts = False
            self._share = max(self._share - self._step, 0.0)
        if self._share == 0.0:
            return ZERO6
        return self._tau if self._share == 1.0 else self._tau * smoothstep(self._share)

    def _time(self, tick: int, mode: Mode, motion: Motion) -> float | None:
        """Return the time of the reference at which forces act; None where none do."""
        if self._faulty or self._left:
            return None
        if mode is Mode.APPROACH:
            t = motion.before(tick, self._trajectory)
            return None if t is None or t < self.forces.start_s else t
        if mode is Mode.TRACKING and motion.trajectory is self._trajectory and motion.on_clock:
            return motion.time(tick)
        return None
