"""What a loop loses along a moving reference because its forces are late: by transport, hold and lag.

A linearising law computes the force for the state that was measured; what acts is the force of some
milliseconds ago. Along the reference that disturbs the axes by

::

    d = J M^-1 J^T (tau_a - tau),   tau_a: tau(t_k + ahead) from t_k + transport on, held, then the lag

which is known, so its response is computed, not bounded: a jump of tau counts by its area, age times height.
When the jump comes between two measurements t_k decides on its age: several such instants are looked at.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from drivers.arrays import Array
from hil.design.stability.disturbance import Linearised
from hil.design.stability.sampled_loop import Axis, Sampled, of_each
from hil.trajectory.path import Trajectory

_APART_s, _NARROW_s = 4e-3, 1e-5
"""Of the instants at which the forces along the reference are looked at, at most and at least."""
_BENT = 2e-4
"""Of the forces' range, by which they may differ from what is in proportion between two instants."""
_FORGOTTEN = 37.0
"""Time constants after which a lag holds less than a rounding of what was."""
_BLOCK_s = 10.0
"""Of the reference that is looked at in one go."""
_PARTS = 8
"""Of a period, at which a disturbance is averaged."""
_PHASES = (0.0, 0.25, 0.5, 0.75)
"""Of a period, by which the measurements are behind the reference's beginning."""


class Late(NamedTuple):
    """What being late costs along a reference, of each axis, from a start without error."""

    error: Array
    """(6,) m or rad, largest."""
    rate: Array
    """(6,) m/s or rad/s."""
    effort: Array
    """(6,) m/s^2 or rad/s^2, of u."""
    stale_s: float
    """How old, at most, or how far ahead, the state is that the acting forces were computed for."""

    @staticmethod
    def none(stale_s: float = 0.0) -> "Late":
        """Return what a reference at rest costs."""
        return Late(np.zeros(6), np.zeros(6), np.zeros(6), stale_s)


def stale_s(axis: Axis, ahead_s: float) -> float:
    """Return how far the state that a force was computed for is from the one that it meets, s, at most."""
    youngest = axis.transport_s - ahead_s
    return max(abs(youngest), abs(youngest + axis.period_s + axis.lag_s))


def late(
    linearised: Linearised,
    reference: Trajectory,
    stretches: Sequence[tuple[float, float]],
    axis: Axis,
    loops: Sequence[Sampled],
    ahead_s: float,
    tell: Callable[[float, float], None] = lambda *_: None,
) -> Late:
    """Return what being late costs along stretches of a reference, by the response of each axis' loop.

    stretches: begin and end in s, each from a start without error, and looked at until its end has settled.
    ahead_s: how far the law looks ahead. tell: called now and then with the s looked at, and of how many.
    """
    T = axis.period_s
    worst = np.zeros((3, 6))
    responses = of_each(loops, Sampled.impulse_responses)
    remembered = max(len(h) for h in responses) - 1
    at_once = int(np.ceil(_BLOCK_s / T))
    for begin, end in stretches:
        settled = end + min(max(loop.steps for loop in loops) * T, end - begin + 1.0)
        count = int(np.ceil((settled - begin) / T)) + 1
        past = np.zeros((len(_PHASES), 0, 6))
        for k in range(0, count, at_once):
            block = k, min(k + at_once, count)
            d = _disturbances(linearised, reference, begin, block, axis, ahead_s)
            d, known = np.concatenate([past, d], axis=1), past.shape[1]
            for phase in d:
                for i, h in enumerate(responses):
                    answers = _convolved(phase[:, i, None], h)[known : len(phase)]
                    worst[:, i] = np.maximum(worst[:, i], np.abs(answers).max(axis=0))
            past = d[:, max(0, d.shape[1] - remembered) :]
            tell(block[1] * T, count * T)
    return Late(worst[0], worst[1], worst[2], stale_s(axis, ahead_s))


def _disturbances(
    linearised: Linearised,
    reference: Trajectory,
    begin_s: float,
    periods: tuple[int, int],
    axis: Axis,
    ahead_s: float,
) -> Array:
    """Return the mean disturbance (phases, n, 6) over each of these periods, the first before `begin_s`."""
    T = axis.period_s
    before = int(np.ceil(20.0 * axis.lag_s / T))  # what the lag remembers
    first, last = periods
    t = begin_s + T * (np.arange(_PARTS * (last - first + before)) + 0.5) / _PARTS + T * (first - before - 1)
    aside = axis.transport_s + 2.0 * T + abs(ahead_s)
    times, tau, matrices = _forces(linearised, reference, t[0] - aside, t[-1] + aside)
    acts = _between(t, times, matrices)
    wanted = _between(t, times, tau)
    d = []
    for phase in _PHASES:
        measured = (np.floor((t - begin_s - axis.transport_s) / T - phase) + phase) * T + begin_s
        real = _lagged(_between(measured + ahead_s, times, tau), axis.lag_s, T / _PARTS)
        parts = np.einsum("tij,tj->ti", acts, real - wanted)
        d.append(parts.reshape(-1, _PARTS, 6).mean(axis=1)[before:])
    return np.array(d)


def _forces(
    linearised: Linearised, reference: Trajectory, low_s: float, high_s: float
) -> tuple[Array, Array, Array]:
    """Return instants (n,) s, the law's forces (n, 6) N there and the accelerations per force (n, 6, 6).

    The more of them, the more the forces bend: a jump lies within `_NARROW_s`.
    """

    def sample(times: Array) -> tuple[Array, Array]:
        return linearised.along_reference([reference.sample(float(at)) for at in times])

    times = np.linspace(low_s, high_s, int(np.ceil((high_s - low_s) / _APART_s)) + 2)
    tau, matrices = sample(times)
    allowed = _BENT * max(float(np.ptp(tau, axis=0).max()), 1e-9)
    left = np.arange(len(times) - 1)  # intervals to be looked at
    while len(left):
        middles = 0.5 * (times[left] + times[left + 1])
        between, each = sample(middles)
        bent = np.abs(between - 0.5 * (tau[left] + tau[left + 1])).max(axis=1) > allowed
        bent &= times[left + 1] - times[left] > _NARROW_s
        places = left + 1 + np.arange(len(left))  # of the middles among all
        times = np.insert(times, left + 1, middles)
        tau, matrices = (np.insert(a, left + 1, b, axis=0) for a, b in ((tau, between), (matrices, each)))
        left = np.sort(np.concatenate([places[bent] - 1, places[bent]]))
    return times, tau, matrices


def _convolved(x: Array, h: Array) -> Array:
    """Return the convolution of x (n, k) or (n, 1) with h (m, k) or (m, 1) along the first axis, by FFT."""
    count = len(x) + len(h) - 1
    size = 1 << (count - 1).bit_length()
    product = np.fft.rfft(x, size, axis=0) * np.fft.rfft(h, size, axis=0)
    return np.asarray(np.fft.irfft(product, size, axis=0)[:count], float)


def _between(t: Array, times: Array, values: Array) -> Array:
    """Return values (n, ...) at rising `times` (n,) for other times t, in proportion; beyond, the nearest."""
    columns = [np.interp(t, times, column) for column in values.reshape(len(times), -1).T]
    return np.stack(columns, axis=-1).reshape(len(t), *values.shape[1:])


def _lagged(x: Array, lag_s: float, step_s: float) -> Array:
    """Return what a first-order lag makes of x (n, 6), from rest, in the middle of each step."""
    if lag_s == 0.0:
        return x
    keep = float(np.exp(-step_s / lag_s))
    lasts = min(len(x), int(np.ceil(_FORGOTTEN * lag_s / step_s)))
    ends = _convolved(x - x[0], np.asarray((1.0 - keep) * keep ** np.arange(lasts)[:, None], float))[: len(x)]
    begins = np.vstack([np.zeros((1, x.shape[1])), ends[:-1]])
    return np.asarray(x[0] + (begins + ends) / 2.0, float)
