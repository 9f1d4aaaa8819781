"""Live set-points, turned into motion within limits on each axis.

The only trajectory with a state, which advances from tick to tick.

Each of the six axes has two stages. The first is a point with bounded velocity V and acceleration A that
moves to the target in the smallest whole number of ticks, and stops there exactly. The second is the mean of
the first over a window T = 2 A / jerk. The mean keeps the bounds V and A, and its third derivative,
(a(t) - a(t - T))/T, is at most 2 A / T.
"""

import math
from typing import Any

import numpy as np

from drivers.arrays import Array
from drivers.compiled.compiler import INTEGER, helper, record
from drivers.compiled.pointed import Callee, address_of, call, context_of, data_at, pointed, reals_at
from drivers.errors import ConfigurationError
from hil.trajectory.path import SAMPLE, CompiledTrajectory, kept, lift, sample_at

LIVE = np.dtype(
    [
        ("tick", "<i8"),
        ("halted", "<i8"),
        ("share", "<f8"),
        ("period", "<f8"),
        ("rows", "<i8"),
        ("history", "<i8"),
        ("window", "<i8", 6),
        *((name, "<f8", 6) for name in ("V", "step", "target", "rest", "x1", "v1", "rest1")),
        *SAMPLE.descr,
    ]
)
"""Layout of the state. halted: 1 if the target is the place of rest; share: allowed fraction of the largest
velocity V; history: address of its rows; window: ticks, per axis; x1, v1, rest1: motion at the next tick
before smoothing, as proposed; then the sample of the tick."""
_SAMPLE = LIVE.itemsize - SAMPLE.itemsize
TO_JUDGE = 1
"""Status of `proceed`: the caller must first check a braking path against the limits."""
WINDOW_S = 4.0
"""Longest window over which the motion is averaged, s."""
_ROUNDING = 1e-9
_LANDED = 1e-12
"""m or rad: a point at rest within this distance has reached its target."""

MARK_S, MOST_MARKS = 0.05, 16
"""Spacing, s, and largest number of the points at which a braking path is checked; the last point is at rest.
The points move with each tick. Their number is limited because each costs about 7 us.
"""
POSITION, SPEED, MEAN, TOTAL = range(4)
"""Columns of the history for each tick: position and speed at the tick, mean position until the next tick,
and sum of the previous means.
"""


@helper
def ticks_to_stop(v: float, step: float) -> float:
    """Whole ticks from speed v to rest, if a tick changes the speed by at most `step` (m/s, rad/s)."""
    return float(np.ceil(abs(v) / step - _ROUNDING))


@helper
def next_speed(distance: float, v: float, V: float, step: float, period: float) -> float:
    """Speed, m/s or rad/s, at the next tick on the fastest way to rest at `distance` (m, rad), from speed v.

    From speed w, n ticks of even braking cover w n period/2, where n is the least with w <= n step. The
    largest w that still stops in time solves distance = (v + w) period/2 + w n period/2, thus
    w = (2 distance/period - v)/(n + 1), with the least n for which n (n + 1) step >= |2 distance/period - v|.
    """
    reach = 2.0 * distance / period - v
    n = np.ceil(0.5 * (math.sqrt(1.0 + 4.0 * abs(reach) / step) - 1.0) - _ROUNDING)
    w = 0.0 if n <= 0.0 or abs(reach) * period < _LANDED else reach / (n + 1.0)
    w = min(max(w, v - step), v + step)
    return min(max(w, -V), V)


@helper
def first_stage(
    x: float, v: float, target: float, V: float, step: float, period: float
) -> tuple[float, float, float]:
    """Position, speed and place of rest (m or rad) of one axis at the next tick, before smoothing.

    The place of rest is where braking from that tick would end; step is A period.
    """
    w = next_speed(target - x, v, V, step, period)
    x1 = x + 0.5 * period * (v + w)
    if w == 0.0 and abs(target - x1) < _LANDED:
        x1 = target
    return x1, w, x1 + 0.5 * period * w * ticks_to_stop(w, step)


@helper
def history_of(live: Any) -> Array:
    """Motion before smoothing, as a flat array: tick k is in row k modulo live.rows; index by `place`."""
    return reals_at(live.history, live.rows * 24)


@helper
def place(row: int, part: int, axis: int) -> int:
    """Index into the flat history of a row, a part (POSITION, SPEED, MEAN or TOTAL) and an axis 0 .. 5."""
    return (row * 4 + part) * 6 + axis


@helper
def propose(live: Any) -> None:
    """Fill x1, v1, rest1: position, speed and place of rest of each axis at the next tick, before smoothing.

    If the share of the velocity decreases, the speed decreases within the acceleration limit. The share does
    not apply to a braking path, which was checked without it.
    """
    history, now = history_of(live), live.tick % live.rows
    for i in range(6):
        v, V, target = history[place(now, SPEED, i)], live.V[i], live.rest[i]
        if not live.halted:
            target = live.target[i]
            if live.share != 1.0:
                V = min(V, max(live.share * V, abs(v) - live.step[i]))
        x1, v1, rest = first_stage(history[place(now, POSITION, i)], v, target, V, live.step[i], live.period)
        live.x1[i], live.v1[i], live.rest1[i] = x1, v1, rest


@helper
def enter(live: Any) -> None:
    """Store x1, v1 of each axis, and the mean position until the next tick; advance to that tick."""
    history, rows, period = history_of(live), live.rows, live.period
    now, then = live.tick % rows, (live.tick + 1) % rows
    for i in range(6):
        v, v1 = history[place(now, SPEED, i)], live.v1[i]
        history[place(now, MEAN, i)] = history[place(now, POSITION, i)] + period * (2.0 * v + v1) / 6.0
        history[place(then, POSITION, i)] = live.x1[i]
        history[place(then, SPEED, i)] = v1
        history[place(then, TOTAL, i)] = history[place(now, TOTAL, i)] + history[place(now, MEAN, i)]
    live.tick += 1


@helper
def braked(s: float, x: float, v: float, n: float, period: float) -> float:
    """Integral over s ticks, in ticks, of a position that brakes evenly from x, v to rest in n ticks."""
    moving = min(s, n)
    curve = moving * moving * (0.5 - moving / (6.0 * n)) if n > 0.0 else 0.0
    return x * s + period * v * (curve + 0.5 * n * (s - moving))


@helper
def way_to_rest(live: Any, chi: Array) -> int:
    """Fill poses (n, 6) m, rad of the platform while it brakes from x1, v1 to rest; return their number.

    The axes come to rest at different times, so intermediate poses are needed, too.
    """
    history, rows, period, k = history_of(live), live.rows, live.period, live.tick
    now = k % rows
    longest = 0
    for i in range(6):
        longest = max(longest, int(ticks_to_stop(live.v1[i], live.step[i])) + live.window[i])
    marks = min(int(np.ceil(longest * period / MARK_S)), MOST_MARKS)
    for i in range(6):
        x1, v1, m = live.x1[i], live.v1[i], live.window[i]
        n = ticks_to_stop(v1, live.step[i])
        mean = history[place(now, POSITION, i)] + period * (2.0 * history[place(now, SPEED, i)] + v1) / 6.0
        total = history[place(now, TOTAL, i)] + mean
        for j in range(marks):
            s = -(-longest * (j + 1) // marks)
            before = braked(s - m, x1, v1, n, period) if s > m else 0.0
            if s < m:
                before = history[place((k + 1 + s - m) % rows, TOTAL, i)] - total
            chi[j, i] = (braked(s, x1, v1, n, period) - before) / m
    return marks


@helper
def proceed(live: Any, tick: int, good: int) -> int:
    """Advance to a tick; return 0, or TO_JUDGE before a step whose braking path must first be checked.

    good: 1 if the braking path of the next step keeps all limits. The sample at the tick is the mean over
    each axis' window.
    """
    while live.tick < tick:
        propose(live)
        if not live.halted:
            moves = False
            for i in range(6):
                moves = moves or live.v1[i] != 0.0
            if moves and not good:
                return TO_JUDGE
            for i in range(6):
                live.rest[i] = live.rest1[i]
        good = 0
        enter(live)
    history, rows, period = history_of(live), live.rows, live.period
    now = live.tick % rows
    chi, dchi, ddchi = np.empty(6), np.empty(6), np.empty(6)
    for i in range(6):
        m = live.window[i]
        x, v = history[place(now, POSITION, i)], history[place(now, SPEED, i)]
        total = 0.0
        row = now
        for _ in range(m):
            row = row - 1 if row > 0 else rows - 1
            total += history[place(row, MEAN, i)] - x
        chi[i] = x + total / m
        dchi[i] = (x - history[place(row, POSITION, i)]) / (m * period)
        ddchi[i] = (v - history[place(row, SPEED, i)]) / (m * period)
    lift(chi, dchi, ddchi, sample_at(address_of(live) + _SAMPLE))
    return 0


@pointed(record(LIVE), INTEGER, INTEGER, INTEGER)
def advance(live: Any, judge: int, context: int, tick: int) -> int:
    """Advance to a tick as `LiveTrajectory.advance`; return 0, or the limits that stopped the motion as bits.

    judge: address of (context, address of a pose, (6,) m, rad) -> 0, or bits of violated limits.
    """
    found = good = 0
    way = np.empty((MOST_MARKS, 6))
    while proceed(live, tick, good) == TO_JUDGE:
        against, mark = 0, way_to_rest(live, way)
        while mark > 0 and against == 0:  # its end first
            mark -= 1
            against = call(judge, (context, np.int64(way[mark].ctypes.data)))
        good = 1 if against == 0 else 0
        if against:
            found = against
            live.halted = 1
    return found


class LiveTrajectory(CompiledTrajectory):
    """Trajectory that moves to the latest target and rests there; `brake` ends it.

    start (6,) m, rad: initial pose; limits (3, 6): largest velocity, acceleration and jerk of the axes.
    Mutable state: the record (target, place of rest, tick, share of the velocity), the history of the first
    stage, and the end time that `brake` sets. `reset` restores the initial state. Raises ConfigurationError
    for a jerk so small that the window would exceed WINDOW_S.
    """

    def __init__(self, start: Array, limits: Array, period_s: float) -> None:
        self._start = np.array(start, float)
        self._period = period_s
        window_s = 2.0 * limits[1] / limits[2]
        if window_s.max() > WINDOW_S:
            raise ConfigurationError(
                f"reference.limits: acceleration over jerk is {window_s.max() / 2:g} s on some axis, "
                f"allowed: at most {WINDOW_S / 2:g} s; raise the jerk or lower the acceleration."
            )
        window = np.ceil(window_s / period_s - _ROUNDING).astype(np.int64).clip(1)
        self._history = np.empty((int(window.max()) + 1, 4, 6))
        self._live = context_of(
            LIVE,
            rows=len(self._history),
            history=self._history,
            period=period_s,
            window=window,
            V=limits[0],
            step=limits[1] * period_s,
        )
        self.callee = Callee(kept.address, data_at(self._live) + _SAMPLE, (self._live, self._history))
        self.reset()

    def reset(self) -> None:
        """Return to the initial pose, at rest, at tick 0."""
        self._live["tick"] = 0
        self._live["share"] = 1.0
        self._live["target"] = self._live["rest"] = self._start
        for name in ("x1", "v1", "rest1"):
            self._live[name] = 0.0
        self._history[:, POSITION] = self._history[:, MEAN] = self._start
        self._history[:, SPEED] = 0.0
        # Row 0 is tick 0; the other rows are earlier ticks.
        before = np.arange(-len(self._history), 0)[:, None] + 1.0
        self._history[:, TOTAL] = np.roll(before, 1, axis=0) * self._start
        self.duration_s: float | None = None
        self.halt()
        advance(self._live, 0, 0, 0)

    def aim(self, chi: Array) -> None:
        """Set the target pose (6,) m, rad; the motion continues towards the target."""
        self._live["target"] = chi
        self._live["halted"] = 0

    def limit(self, share: float) -> None:
        """Allow a share 0 .. 1 of the largest velocity; faster motion slows within the acceleration limit."""
        self._live["share"] = share

    def halt(self) -> None:
        """Brake to rest as soon as the limits allow, and stay there until `aim` sets a target."""
        self._live["halted"] = 1

    @property
    def resting(self) -> bool:
        """True if the motion has been halted, and the platform is at rest."""
        live = self._live
        return bool(live["halted"]) and not (live["twist"].any() or live["dtwist"].any())

    def brake(self) -> None:
        """Brake to rest as soon as the limits allow; set `duration_s` to a time when that has ended."""
        tick = int(self._live["tick"])
        v = self._history[tick % len(self._history), SPEED]
        ticks = int(np.ceil(np.abs(v) / self._live["step"] - _ROUNDING).max())
        self.halt()
        self.duration_s = (tick + ticks + 1 + len(self._history)) * self._period

    @property
    def steer(self) -> Callee:
        """C function (record, judge, its context, tick) of `advance`, for compiled code."""
        return Callee(advance.address, data_at(self._live), self)

    def advance(self, tick: int, judge: Callee) -> int:
        """Advance to a tick, counted from time zero.

        judge: (context, address of a pose, (6,) m, rad) -> 0, or bits of violated limits. Before each step it
        checks the poses of the braking path after that step. If all keep the limits, the motion continues
        towards the target. Otherwise it brakes at once along the path checked one tick before, and the end
        of this path becomes the target. Returns the bits of violated limits, or 0.
        """
        return int(advance(self._live, judge.address, judge.context, tick))
