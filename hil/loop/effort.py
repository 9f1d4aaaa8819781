"""The requested leg forces: the law's, the transition from the holding force, and learned forces."""

from math import isnan, nan
from typing import Any

import numpy as np

from drivers.arrays import ZERO6, Array
from drivers.compiled.compiler import INTEGER, helper, record
from drivers.compiled.pointed import Callee, context_of, data_at, pointed, reals_at
from drivers.signals import Mode
from drivers.tick_columns import Record
from hil.control.pointed_law import called_by_pointer
from hil.loop.modes import Durations
from hil.loop.motion import MOTION, Motion, ticks_left
from hil.loop.parts import Parts
from hil.loop.reference import LearnedForces, smoothstep, tau_at_rest
from hil.trajectory.override import OVERRIDE, is_full, time_at
from hil.trajectory.path import PoseSample, Trajectory

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
"""Address of the forces (count, 6) N; their times; change of the share per tick; the state of `Learned`."""


@helper
def between(rows: Array, place: float, into: Array) -> None:
    """Fill `into` (6,) with rows (6 n,) interpolated at index `place`, 0 .. n - 1; then the last row."""
    last = len(rows) // 6 - 2
    place = min(place, last + 1.0)
    k = min(int(place), last)
    for i in range(6):
        before, after = rows[6 * k + i], rows[6 * k + 6 + i]
        into[i] = before + (place - k) * (after - before)


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
    """Fill in the learned forces of a tick, (6,) N at address `into`; returns 1 if any of them acts, else 0.

    mode_tick: when the mode was entered; along: result of `Learned.along`; faults: the latched ones.
    """
    t = nan  # of the reference, at which forces could act, s: before 0 on the way to its start
    if along and is_full(override):  # else path time is not the clock's
        t = time_at(override, tick)
        if mode == _APPROACH:
            t = -ticks_left(motion, override, tick) * override.period
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
    share = 1.0 if k.share == 1.0 else smoothstep(k.share)
    for i in range(6):
        tau[i] = k.tau[i] * share
    return 1 if k.share > 0.0 else 0


class Learned:
    """Forces learned from earlier runs, and the share of them that acts.

    They act on the reference on which they were learned, and on the last part of the way to its start, while
    path time equals clock time. When TRACKING leaves that (hold, speed, jog, park, stop), the last force
    fades out, and none acts until the reference starts again. At the reference's end the last force stays
    until the brakes are shut, and fades with the holding force. After a fault none acts.

    Mutable state: whether a fault has struck, whether the reference has been left, and the forces with their
    share, 0 .. 1; `reset` restores the initial state.
    """

    def __init__(self, forces: LearnedForces, trajectory: Trajectory, period_s: float) -> None:
        self.forces = forces
        self._trajectory = trajectory
        self._rows = np.ascontiguousarray(forces.tau, np.float64)
        times = {"start_s": forces.start_s, "step_s": forces.step_s, "step": period_s / forces.fade_s}
        self._record = context_of(LEARNED, rows=self._rows, count=len(self._rows), **times)
        self.look = Callee(step.address, data_at(self._record), self)
        """Arguments: (learned, motion, override, tick, mode, mode_tick, along, faults, address of the
        forces)."""
        self.reset()

    def reset(self) -> None:
        """Restore the state before the first tick."""
        for name in ("faulty", "acts", "left", "share", "tau"):
            self._record[name] = 0

    def along(self, mode: Mode, motion: Motion) -> bool:
        """True while the platform follows the reference of the learned forces, or moves to its start."""
        if mode is Mode.APPROACH:
            return motion.then is self._trajectory
        return mode is Mode.TRACKING and motion.trajectory is self._trajectory and not motion.away


class Effort:
    """The law's and the learned forces, with the ramps at the start and end of a motion.

    Mutable state, all of it public; `reset` restores the initial state.
    """

    def __init__(self, parts: Parts, durations: Durations) -> None:
        self.parts = parts
        self.durations = durations
        self.period_s = 1.0 / parts.rate_Hz
        self.law = called_by_pointer(parts.law)
        """The law's function, with the object that owns it and the exception that it raised."""
        self.model = parts.model
        forces = parts.learned
        self.learned = None if forces is None else Learned(forces, parts.trajectory, self.period_s)
        self.reach_N = float(parts.safety.limits["force_window_N"])
        """Largest difference between the law's force and the holding force while the platform is held.
        Without a limit, the law would push a brake open when a drifting encoder makes its leg seem to move.
        """
        self.reset()

    def reset(self) -> None:
        """Restore the state before the first tick."""
        self.holding = ZERO6
        """(6,) N: force that holds weight and external wrench while the brakes open, or the force as they
        close."""
        self.offset = ZERO6
        """(6,) N: holding force minus the law's own at the moment of entry; fades out."""
        self.entry_tick: int | None = None
        """Tick at which the entry offset began to fade; None before that."""
        self.last_tau = ZERO6
        if self.learned is not None:
            self.learned.reset()

    def statics(self, p: Array, R: Array, wrench: Array) -> Array:
        """Leg forces (6,) N, push positive, that hold the platform at rest at a pose against a wrench.

        p (3,) m, R (3, 3); wrench (6,) N, N m on the platform at its origin; all in the base frame.
        """
        return self.model.inverse_dynamics(p, R, ZERO6, ZERO6, wrench)

    def hold(self, tick: Record, holding: Array, sample: PoseSample, *, on_it: bool = False) -> None:
        """Start to hold with forces (6,) N at a sample at rest; on_it: as if the platform were at the sample.

        The offset is the difference to the force that the law requests there without load. The law is
        evaluated as at entry: it starts in this very tick, so the offset fits.
        """
        self.entry_tick, self.holding = None, holding
        self.offset = holding - tau_at_rest(self.law.keeps, self.parts.platform, tick, sample, on_it=on_it)
