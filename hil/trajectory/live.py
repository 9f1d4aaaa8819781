"""Set-points that come while the platform moves, turned into motion within limits of each axis.

The one trajectory that has a state, which goes from tick to tick.

Two stages on each of the six words. The first steers a point with bounded velocity V and acceleration A to
the target in whole ticks, as fast as that can be, and lands on it exactly. The second is the mean of the
first over a window T = 2 A / jerk: a mean of what is bounded by V and A is bounded by V and A, and its third
derivative, (a(t) - a(t - T))/T, by 2 A / T.
"""

import math
from collections.abc import Callable

import numpy as np

from drivers.arrays import Array, Ints
from drivers.compiled.compiler import INTEGER, OUT_MATRIX, REAL, VECTOR, direct, helper, kernel
from drivers.errors import ConfigurationError
from hil.trajectory.path import SAMPLE, PoseSample, blank, lift
from hil.trajectory.piecewise import TENSOR

WORDS = VECTOR.copy(dtype=INTEGER)
HISTORY = OUT_MATRIX.copy(ndim=3)
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


@kernel(VECTOR, VECTOR, VECTOR, VECTOR, VECTOR, REAL)
def propose(
    x: Array, v: Array, target: Array, V: Array, step: Array, period: float
) -> tuple[Array, Array, Array]:
    """Position, speed and the place of rest of the first stage at the next tick, (6,) each.

    The place of rest is where braking from then on ends; step (6,) is A period.
    """
    x1, v1, rest = np.empty(6), np.empty(6), np.empty(6)
    for i in range(6):
        w = next_speed(target[i] - x[i], v[i], V[i], step[i], period)
        x1[i] = x[i] + 0.5 * period * (v[i] + w)
        if w == 0.0 and abs(target[i] - x1[i]) < _LANDED:
            x1[i] = target[i]
        v1[i] = w
        rest[i] = x1[i] + 0.5 * period * w * ticks_to_stop(w, step[i])
    return x1, v1, rest


@kernel(HISTORY, INTEGER, VECTOR, VECTOR, REAL)
def enter(history: Array, k: int, x1: Array, v1: Array, period: float) -> None:
    """Enter position and speed of tick k + 1 into the history, and the mean position from tick k to it."""
    rows = history.shape[0]
    now, then = k % rows, (k + 1) % rows
    for i in range(6):
        v = history[now, SPEED, i]
        history[now, MEAN, i] = history[now, POSITION, i] + period * (2.0 * v + v1[i]) / 6.0
        history[then, POSITION, i] = x1[i]
        history[then, SPEED, i] = v1[i]
        history[then, TOTAL, i] = history[now, TOTAL, i] + history[now, MEAN, i]


@helper
def braked(s: float, x: float, v: float, n: float, period: float) -> float:
    """Integral over the next s ticks (in ticks) of a position that is braked evenly from x, v in n ticks."""
    moving = min(s, n)
    curve = moving * moving * (0.5 - moving / (6.0 * n)) if n > 0.0 else 0.0
    return x * s + period * v * (curve + 0.5 * n * (s - moving))


@kernel(TENSOR, INTEGER, WORDS, VECTOR, VECTOR, VECTOR, REAL)
def way_to_rest(
    history: Array, k: int, window: Ints, x1: Array, v1: Array, step: Array, period: float
) -> Array:
    """Words (n, 6) at which the platform would be if it braked from x1, v1 (6,) at tick k + 1 on.

    The axes come to rest one after the other: where the last of them does is not all of the way.
    """
    rows = history.shape[0]
    now = k % rows
    longest = 0
    for i in range(6):
        longest = max(longest, int(ticks_to_stop(v1[i], step[i])) + window[i])
    marks = min(int(np.ceil(longest * period / MARK_S)), MOST_MARKS)
    chi = np.empty((marks, 6))
    for i in range(6):
        m, n = window[i], ticks_to_stop(v1[i], step[i])
        mean = history[now, POSITION, i] + period * (2.0 * history[now, SPEED, i] + v1[i]) / 6.0
        total = history[now, TOTAL, i] + mean
        for j in range(marks):
            s = -(-longest * (j + 1) // marks)
            before = braked(s - m, x1[i], v1[i], n, period) if s > m else 0.0
            if s < m:
                before = history[(k + 1 + s - m) % rows, TOTAL, i] - total
            chi[j, i] = (braked(s, x1[i], v1[i], n, period) - before) / m
    return chi


@direct(TENSOR, INTEGER, WORDS, REAL, *SAMPLE)
def evaluate(
    history: Array, k: int, window: Ints, period: float,
    p: Array, R: Array, twist: Array, dtwist: Array,
) -> None:  # fmt: skip
    """Fill p, R, twist, dtwist at tick k: the means over each word's window (6,) of ticks."""
    rows = history.shape[0]
    now = k % rows
    chi, dchi, ddchi = np.empty(6), np.empty(6), np.empty(6)
    for i in range(6):
        m = window[i]
        x, v = history[now, POSITION, i], history[now, SPEED, i]
        total = 0.0
        row = now
        for _ in range(m):
            row = row - 1 if row > 0 else rows - 1
            total += history[row, MEAN, i] - x
        chi[i] = x + total / m
        dchi[i] = (x - history[row, POSITION, i]) / (m * period)
        ddchi[i] = (v - history[row, SPEED, i]) / (m * period)
    lift(chi, dchi, ddchi, p, R, twist, dtwist)


class LiveTrajectory:
    """Goes to wherever it was last sent, holds there, and stops on `brake`.

    start (6,) m, rad: where it begins; limits (3, 6): largest velocity, acceleration and jerk of the words.
    Mutable state: the target, the place of rest, the tick, the history of the first stage, the share of its
    velocity that is allowed, and the end that `brake` sets. `reset` restores the initial one. Raises
    ConfigurationError where a jerk is so small that the window would be longer than WINDOW_S.
    """

    def __init__(self, start: Array, limits: Array, period_s: float) -> None:
        self._start = np.array(start, float)
        self._period = period_s
        self._V = np.array(limits[0], float)
        self._step = limits[1] * period_s
        window_s = 2.0 * limits[1] / limits[2]
        if window_s.max() > WINDOW_S:
            raise ConfigurationError(
                f"reference.limits: acceleration over jerk is {window_s.max() / 2:g} s on some axis, "
                f"allowed: at most {WINDOW_S / 2:g} s; raise the jerk or lower the acceleration."
            )
        self._window = np.ceil(window_s / period_s - _ROUNDING).astype(np.int64).clip(1)
        self._history = np.empty((int(self._window.max()) + 1, 4, 6))
        self.reset()

    def reset(self) -> None:
        """Back to the start, at rest, at time zero."""
        self._tick = 0
        self._share = 1.0
        """Of the largest velocity: what is allowed."""
        self._target = self._start
        self._rest = self._start
        self._history[:, POSITION] = self._history[:, MEAN] = self._start
        self._history[:, SPEED] = 0.0
        # Row 0 is tick 0, the others came before it.
        before = np.arange(-len(self._history), 0)[:, None] + 1.0
        self._history[:, TOTAL] = np.roll(before, 1, axis=0) * self._start
        self.duration_s: float | None = None
        self._sample = self._evaluate()

    def aim(self, chi: Array) -> None:
        """Set the target (6,) m, rad."""
        self._target = chi

    def limit(self, share: float) -> None:
        """Allow a share 0 .. 1 of the largest velocity; what is faster is braked within the acceleration."""
        self._share = share

    def halt(self) -> None:
        """Come to rest as soon as the limits allow, and stay there until there is another target."""
        self._target = self._rest

    @property
    def resting(self) -> bool:
        """Whether it stands still at the place of rest."""
        return self._target is self._rest and not (self._sample.twist.any() or self._sample.dtwist.any())

    def brake(self) -> None:
        """Come to rest as soon as the limits allow; from then on there is an end."""
        v = self._history[self._tick % len(self._history), SPEED]
        ticks = int(np.ceil(np.abs(v) / self._step - _ROUNDING).max())
        self._target = self._rest
        self.duration_s = (self._tick + ticks + 1 + len(self._history)) * self._period

    def advance(self, tick: int, admit: Callable[[Array], int]) -> int:
        """Go on to a tick, counted from time zero.

        `admit` judges a pose (6,) m, rad: 0 for a good one. As long as the way to rest of a braking that
        begins with the next tick is good it goes on towards the target; else it brakes at once, on the way
        that was good a tick ago, whose end becomes the target. Returns what was found against the way, or 0.
        """
        found = 0
        while self._tick < tick:
            row = self._history[self._tick % len(self._history)]
            x, v = row[POSITION].copy(), row[SPEED].copy()
            x1, v1, rest = propose(x, v, self._target, self._allowed(v), self._step, self._period)
            if self._target is not self._rest and v1.any():
                against = self._judge(x1, v1, admit)
                if against:
                    found = against
                    self._target = self._rest
                    x1, v1, rest = propose(x, v, self._target, self._V, self._step, self._period)
            if self._target is not self._rest:
                self._rest = rest
            enter(self._history, self._tick, x1, v1, self._period)
            self._tick += 1
        self._sample = self._evaluate()
        return found

    def _allowed(self, v: Array) -> Array:
        """Return the velocities (6,) allowed at the next tick, from v (6,): no jump to a lower share.

        On the way to rest the share does not count: that way has been judged as it is.
        """
        if self._share == 1.0 or self._target is self._rest:
            return self._V
        V: Array = np.minimum(self._V, np.maximum(self._share * self._V, np.abs(v) - self._step))
        return V

    def _judge(self, x1: Array, v1: Array, admit: Callable[[Array], int]) -> int:
        """Return what is first found against the way to rest from x1, v1 at the next tick, its end first."""
        way = way_to_rest(self._history, self._tick, self._window, x1, v1, self._step, self._period)
        return next(filter(None, map(admit, way[::-1])), 0)

    def sample(self, t: float) -> PoseSample:  # noqa: ARG002 - what comes later is not known
        """Return the sample of the tick last advanced to."""
        return self._sample

    def _evaluate(self) -> PoseSample:
        sample = blank()
        evaluate(self._history, self._tick, self._window, self._period, *sample)
        return sample
