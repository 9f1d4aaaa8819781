"""Set-points that come while the platform moves, turned into motion within limits of each axis.

The one trajectory that has a state, which goes from tick to tick.

Two stages on each of the six words. The first steers a point with bounded velocity V and acceleration A to
the target in whole ticks, as fast as that can be, and lands on it exactly. The second is the mean of the
first over a window T = 2 A / jerk: a mean of what is bounded by V and A is bounded by V and A, and its third
derivative, (a(t) - a(t - T))/T, by 2 A / T.
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
"""halted: 1 where the place of rest is the target; share: of the largest velocity V, what is allowed;
history: the address of its rows; window: of each word, ticks; x1, v1, rest1: the next tick as it is proposed;
and the sample of the tick."""
_SAMPLE = LIVE.itemsize - SAMPLE.itemsize
TO_JUDGE = 1
"""Status of `proceed`."""
WINDOW_S = 4.0
"""Longest window of the second stage."""
_ROUNDING = 1e-9
_LANDED = 1e-12
"""m or rad: nearer than that, at rest, is there."""

MARK_S, MOST_MARKS = 0.05, 16
"""How far the instants lie apart, s, at which the way to rest is judged, and the most of them, the last at
rest. They move along from tick to tick; what they cost, some 7 us each, limits them."""
POSITION, SPEED, MEAN, TOTAL = range(4)
"""What the history keeps of each tick: position and speed at it, the mean position until the next one, and
the sum of the means before it."""


@helper
def ticks_to_stop(v: float, step: float) -> float:
    """Whole ticks in which a speed v is braked to rest, by at most `step` (m/s or rad/s) in each."""
    return float(np.ceil(abs(v) / step - _ROUNDING))


@helper
def next_speed(distance: float, v: float, V: float, step: float, period: float) -> float:
    """Speed at the next tick on the fastest way to rest at `distance`, from speed v.

    From speed w, n ticks of even braking take w n period/2, where n is the least with w <= n step. The
    fastest w that leaves just that solves distance = (v + w) period/2 + w n period/2, thus
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
    """Position, speed and the place of rest of a word of the first stage at the next tick.

    The place of rest is where braking from then on ends; step is A period.
    """
    w = next_speed(target - x, v, V, step, period)
    x1 = x + 0.5 * period * (v + w)
    if w == 0.0 and abs(target - x1) < _LANDED:
        x1 = target
    return x1, w, x1 + 0.5 * period * w * ticks_to_stop(w, step)


@helper
def history_of(live: Any) -> Array:
    """Return the history of the first stage: tick k in row k modulo their number, see `place`."""
    return reals_at(live.history, live.rows * 24)


@helper
def place(row: int, part: int, word: int) -> int:
    """Where the history has a part of a word."""
    return (row * 4 + part) * 6 + word


@helper
def propose(live: Any) -> None:
    """Fill x1, v1, rest1: the first stage at the next tick.

    No velocity jumps to a lower share. On the way to rest the share does not count: that way has been judged
    as it is.
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
    """Enter x1, v1 of the next tick into the history, and the mean position until then; go on to it."""
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
    """Integral over the next s ticks (in ticks) of a position that is braked evenly from x, v in n ticks."""
    moving = min(s, n)
    curve = moving * moving * (0.5 - moving / (6.0 * n)) if n > 0.0 else 0.0
    return x * s + period * v * (curve + 0.5 * n * (s - moving))


@helper
def way_to_rest(live: Any, chi: Array) -> int:
    """Fill words (n, 6) at which the platform would be if it braked from x1, v1 on; return their number.

    The axes come to rest one after the other: where the last of them does is not all of the way.
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
    """Go on to a tick; return 0, or TO_JUDGE before the first step of which the way to rest is to be judged.

    good: 1 where that of the very next step has been judged. The sample at the tick is of the means over each
    word's window of ticks.
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
    """Go on to a tick, see `LiveTrajectory.advance`; return what was found against the way, or 0.

    judge: address of (context, address of a pose, (6,) m, rad) -> 0 for a good one.
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
    """Goes to wherever it was last sent, holds there, and stops on `brake`.

    start (6,) m, rad: where it begins; limits (3, 6): largest velocity, acceleration and jerk of the words.
    Mutable state: the record, with the target, the place of rest, the tick and the share of its velocity that
    is allowed, the history of the first stage, and the end that `brake` sets. `reset` restores the initial
    one. Raises ConfigurationError where a jerk is so small that the window would be longer than WINDOW_S.
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
        """Back to the start, at rest, at time zero."""
        self._live["tick"] = 0
        self._live["share"] = 1.0
        self._live["target"] = self._live["rest"] = self._start
        for name in ("x1", "v1", "rest1"):
            self._live[name] = 0.0
        self._history[:, POSITION] = self._history[:, MEAN] = self._start
        self._history[:, SPEED] = 0.0
        # Row 0 is tick 0, the others came before it.
        before = np.arange(-len(self._history), 0)[:, None] + 1.0
        self._history[:, TOTAL] = np.roll(before, 1, axis=0) * self._start
        self.duration_s: float | None = None
        self.halt()
        advance(self._live, 0, 0, 0)

    def aim(self, chi: Array) -> None:
        """Set the target (6,) m, rad."""
        self._live["target"] = chi
        self._live["halted"] = 0

    def limit(self, share: float) -> None:
        """Allow a share 0 .. 1 of the largest velocity; what is faster is braked within the acceleration."""
        self._live["share"] = share

    def halt(self) -> None:
        """Come to rest as soon as the limits allow, and stay there until there is another target."""
        self._live["halted"] = 1

    @property
    def resting(self) -> bool:
        """Whether it stands still at the place of rest."""
        live = self._live
        return bool(live["halted"]) and not (live["twist"].any() or live["dtwist"].any())

    def brake(self) -> None:
        """Come to rest as soon as the limits allow; from then on there is an end."""
        tick = int(self._live["tick"])
        v = self._history[tick % len(self._history), SPEED]
        ticks = int(np.ceil(np.abs(v) / self._live["step"] - _ROUNDING).max())
        self.halt()
        self.duration_s = (tick + ticks + 1 + len(self._history)) * self._period

    @property
    def steer(self) -> Callee:
        """(record, address of a judge, its context, tick): what `advance` calls."""
        return Callee(advance.address, data_at(self._live), self)

    def advance(self, tick: int, judge: Callee) -> int:
        """Go on to a tick, counted from time zero.

        judge: (context, address of a pose, (6,) m, rad) -> 0 for a good one. As long as the way to rest of a
        braking that begins with the next tick is good it goes on towards the target; else it brakes at once,
        on the way that was good a tick ago, whose end becomes the target. Returns what was found against the
        way, or 0.
        """
        return int(advance(self._live, judge.address, judge.context, tick))
