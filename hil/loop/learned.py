"""The learned feed-forward of a tick: when it acts, and how it comes and goes without a bump."""

from math import isnan, nan
from typing import Any, NamedTuple

import numpy as np

from drivers.arrays import Array
from drivers.compiled.compiler import INTEGER, helper, record
from drivers.compiled.pointed import Callee, data_at, pointed, reals_at
from drivers.signals import Mode
from hil.loop.motion import MOTION, Motion, ticks_left
from hil.loop.ramps import smoothstep
from hil.trajectory.override import OVERRIDE, is_full, time_at
from hil.trajectory.path import Trajectory

_APPROACH, _TRACKING, _PARKING = int(Mode.APPROACH), int(Mode.TRACKING), int(Mode.PARKING)
LEARNED = np.dtype(
    [
        ("rows", "<i8"),
        ("count", "<i8"),
        ("start_s", "<f8"),
        ("step_s", "<f8"),
        ("step", "<f8"),
        *((name, "<i8") for name in ("faulty", "acts", "left")),
        ("share", "<f8"),
        ("tau", "<f8", 6),
    ]
)
"""Where the forces (count, 6) N are; their times; what a tick adds to the share; the state of `Learned`."""


@helper
def between(rows: Array, place: float, into: Array) -> None:
    """Fill `into` (6,) with `rows` (6 n,) at a place 0 .. n - 1, linear between two rows; the last behind."""
    last = len(rows) // 6 - 2
    place = min(place, last + 1.0)
    k = min(int(place), last)
    for i in range(6):
        before, after = rows[6 * k + i], rows[6 * k + 6 + i]
        into[i] = before + (place - k) * (after - before)


@helper
def time_of_reference(motion: Any, override: Any, tick: int, mode: int, along: int) -> float:
    """Return the time of the reference at which forces could act, s: before 0 on the way to its start.

    along: on the reference, or on the way to it. Off it, and where path time is not the clock's, nan.
    """
    if not along or not is_full(override):
        return nan
    if mode == _APPROACH:
        return float(-ticks_left(motion, override, tick) * override.period)
    return float(time_at(override, tick))


@pointed(
    record(LEARNED), record(MOTION), record(OVERRIDE), INTEGER, INTEGER, INTEGER, INTEGER, INTEGER, INTEGER
)
def step(
    k: Any,
    motion: Any,
    override: Any,
    tick: int,
    mode: int,
    mode_tick: int,
    along: int,
    faults: int,
    into: int,
) -> int:
    """Fill the forces of a tick, (6,) N at `into`, in a mode entered at mode_tick; return 1 where any act.

    along: of `Learned.along`; faults: those latched.
    """
    t = time_of_reference(motion, override, tick, mode, along)
    if faults:
        k.faulty = 1
    if tick == mode_tick and mode in (_APPROACH, _TRACKING):
        k.left = 0
    early = mode == _APPROACH and t < k.start_s
    on = not (isnan(t) or early or k.faulty or k.left)
    if on and (k.acts or k.share == 0.0):
        k.acts = 1
        k.share = min(k.share + k.step, 1.0)
        between(reals_at(k.rows, 6 * k.count), (t - k.start_s) / k.step_s, k.tau)
    elif mode != _PARKING or k.faulty:
        if k.acts and mode == _TRACKING and tick != mode_tick:
            k.left = 1
        k.acts = 0
        k.share = max(k.share - k.step, 0.0)
    tau = reals_at(into, 6)
    share = smoothstep(k.share)
    for i in range(6):
        tau[i] = k.tau[i] if k.share == 1.0 else k.tau[i] * share
    return 1 if k.share > 0.0 else 0


class LearnedForces(NamedTuple):
    """Leg forces over the time of one reference, and over the last of the way to its start."""

    tau: Array
    """(n, 6) N at start_s, start_s + step_s, ... Read-only."""
    start_s: float
    """At most 0: time before the reference begins."""
    step_s: float
    fade_s: float
    """In which they fade in and out."""


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
        self._rows = np.ascontiguousarray(forces.tau, np.float64)
        self._record = np.zeros((), LEARNED)
        for name, value in {
            "rows": data_at(self._rows),
            "count": len(self._rows),
            "start_s": forces.start_s,
            "step_s": forces.step_s,
            "step": period_s / forces.fade_s,
        }.items():
            self._record[name] = value
        self.look = Callee(step.address, data_at(self._record), self)
        """(learned, motion, override, tick, mode, mode_tick, along, faults, where the forces go)."""
        self.reset()

    def reset(self) -> None:
        """Back to the state before the first tick."""
        for name in ("faulty", "acts", "left", "share", "tau"):
            self._record[name] = 0

    def along(self, mode: Mode, motion: Motion) -> bool:
        """Tell whether the platform is on the reference of the forces, or on the way to its start."""
        if mode is Mode.APPROACH:
            return motion.then is self._trajectory
        return mode is Mode.TRACKING and motion.trajectory is self._trajectory and not motion.away
