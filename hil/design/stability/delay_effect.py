"""Tracking error along a moving reference that the delay of the forces causes: transport, hold and lag.

A linearising law computes the force for the measured state, but the acting force is some milliseconds old.
Along the reference this delay disturbs the axes by

::

    d = J M^-1 J^T (tau_a - tau),   tau_a: tau(t_k + ahead) from t_k + transport on, held, then the lag

d is known, so its response is computed, not bounded. An observer of the wrench sees the part of d
that its own force path does not explain. A jump of tau counts by its area, age times height. Its
age depends on the time of the jump between two measurements t_k: several phases are evaluated.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from drivers.arrays import Array
from hil.design.stability.disturbance import Linearised
from hil.design.stability.observed_loop import Observer
from hil.design.stability.sampled_loop import Axis, Sampled, of_each
from hil.trajectory.path import Trajectory, of_record, samples

_APART_s, _NARROW_s = 4e-3, 1e-5
"""Largest and smallest distance of the instants at which the forces along the reference are evaluated."""
_BENT = 2e-4
"""Allowed deviation from linear interpolation between two instants, as a share of the forces' range."""
_FORGOTTEN = 37.0
"""Number of time constants after which the response of a lag is below rounding."""
_BLOCK_s = 10.0
"""Length, s, of the parts into which the evaluation of a reference is divided."""
_PARTS = 8
"""Number of points per period over which a disturbance is averaged."""
_SURVEYED, _STRETCH_s, _STRETCHES = 5000, 4.0, 12
"""Of a long reference: number of surveyed instants, length and number of the stretches to evaluate."""
LONG_s = 120.0
"""Longest reference that is evaluated as a whole."""
_PHASES = (0.0, 0.25, 0.5, 0.75)
"""Times, in periods, by which the first measurement comes after the reference's beginning."""


class DelayEffect(NamedTuple):
    """Error of each axis along a reference caused by delay, from a start without error."""

    error: Array
    """(6,) m or rad, largest error of each axis."""
    rate: Array
    """(6,) m/s or rad/s, largest error of the rate of each axis."""
    effort: Array
    """(6,) m/s^2 or rad/s^2, largest of u."""
    stale_s: float
    """Largest time difference, either sign, between the acting forces' state and the present one."""

    @staticmethod
    def none(stale_s: float = 0.0) -> "DelayEffect":
        """Effect without error, for a reference at rest; stale_s as in the class."""
        return DelayEffect(np.zeros(6), np.zeros(6), np.zeros(6), stale_s)


def stale_s(axis: Axis, ahead_s: float) -> float:
    """Largest time difference, s, from the state for which a force is computed to that on which it acts."""
    youngest = axis.transport_s - ahead_s
    return max(abs(youngest), abs(youngest + axis.period_s + axis.lag_s))


def delay_effect(
    linearised: Linearised,
    reference: Trajectory,
    stretches: Sequence[tuple[float, float]],
    axis: Axis,
    loops: Sequence[Sampled],
    ahead_s: float,
    tell: Callable[[float, float], None] = lambda *_: None,
    observer: Observer | None = None,
) -> DelayEffect:
    """Error along stretches of a reference caused by delay, from the response of each axis' loop.

    stretches: begin and end in s, each from a start without error, and evaluated until its end has settled.
    ahead_s: prediction horizon of the law. tell: progress callback with the seconds done, and in total.
    """
    T = axis.period_s
    worst = np.zeros((3, 6))
    responses = of_each(loops, lambda loop: loop.responses(0)[1:])
    paths = [axis]
    if observer is not None:
        responses += of_each(loops, lambda loop: loop.responses(3))
        paths.append(axis._replace(transport_s=observer.transport_s, lag_s=observer.lag_s))
    remembered = max(len(h) for h in responses) - 1
    at_once = int(np.ceil(_BLOCK_s / T))
    for begin, end in stretches:
        settled = end + min(max(loop.steps for loop in loops) * T, end - begin + 1.0)
        count = int(np.ceil((settled - begin) / T)) + 1
        past = np.zeros((len(_PHASES), 0, 6 * len(paths)))
        for k in range(0, count, at_once):
            block = k, min(k + at_once, count)
            new = [_disturbances(linearised, reference, begin, block, path, ahead_s) for path in paths]
            new[1:] = [-explained for explained in new[1:]]
            d, known = np.concatenate([past, np.concatenate(new, axis=2)], axis=1), past.shape[1]
            for phase in d:
                for i in range(6):
                    answers = sum(
                        _convolved(phase[:, j, None], responses[j])[known : len(phase)]
                        for j in range(i, len(responses), 6)
                    )
                    worst[:, i] = np.maximum(worst[:, i], np.abs(answers).max(axis=0))
            past = d[:, max(0, d.shape[1] - remembered) :]
            tell(block[1] * T, count * T)
    return DelayEffect(worst[0], worst[1], worst[2], stale_s(axis, ahead_s))


def demanding_stretches(
    linearised: Linearised, reference: Trajectory, span_s: float, axis: Axis
) -> list[tuple[float, float]]:
    """Stretches of a long reference, begin and end in s, in which a delay of the forces disturbs most.

    Ranked by the change of the accelerations within a period, at evenly spread instants and at knots.
    """
    knots = getattr(reference, "knots", np.zeros(0))
    t = np.concatenate([np.linspace(0.0, span_s, _SURVEYED), knots[:: 1 + len(knots) // _SURVEYED]])
    half = 0.5 * axis.period_s
    (before, _), (after, acts) = (
        linearised.along_reference(of_record(samples(reference, np.clip(each, 0.0, span_s))))
        for each in (t - half, t + half)
    )
    change = np.zeros(int(span_s / _STRETCH_s) + 1)
    felt = np.abs(np.einsum("tij,tj->ti", acts, after - before)).max(axis=1)
    np.maximum.at(change, (t / _STRETCH_s).astype(int), felt)
    begins = _STRETCH_s * np.sort(np.argsort(-change, kind="stable")[:_STRETCHES])
    return [(max(0.0, at - 0.5 * _STRETCH_s), min(at + _STRETCH_s, span_s)) for at in begins.tolist()]


def _disturbances(
    linearised: Linearised,
    reference: Trajectory,
    begin_s: float,
    periods: tuple[int, int],
    axis: Axis,
    ahead_s: float,
) -> Array:
    """Mean disturbance (phases, n, 6) of the axes over each of n periods, the first before `begin_s`."""
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
    """Instants (n,) s, the law's forces (n, 6) N there and the accelerations per force (n, 6, 6).

    The instants are denser where the forces bend; a jump is located within `_NARROW_s`.
    """

    def sample(times: Array) -> tuple[Array, Array]:
        return linearised.along_reference(of_record(samples(reference, times)))

    times = np.linspace(low_s, high_s, int(np.ceil((high_s - low_s) / _APART_s)) + 2)
    tau, matrices = sample(times)
    allowed = _BENT * max(float(np.ptp(tau, axis=0).max()), 1e-9)
    left = np.arange(len(times) - 1)  # intervals to evaluate
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
    """Convolution of x (n, k) or (n, 1) with h (m, k) or (m, 1) along the first axis, by FFT."""
    count = len(x) + len(h) - 1
    size = 1 << (count - 1).bit_length()
    product = np.fft.rfft(x, size, axis=0) * np.fft.rfft(h, size, axis=0)
    return np.asarray(np.fft.irfft(product, size, axis=0)[:count], float)


def _between(t: Array, times: Array, values: Array) -> Array:
    """Linear interpolation at t of values (n, ...) at rising `times` (n,); outside, the nearest value."""
    columns = [np.interp(t, times, column) for column in values.reshape(len(times), -1).T]
    return np.stack(columns, axis=-1).reshape(len(t), *values.shape[1:])


def _lagged(x: Array, lag_s: float, step_s: float) -> Array:
    """Response of a first-order lag to x (n, 6), from a steady state, at the middle of each step."""
    if lag_s == 0.0:
        return x
    keep = float(np.exp(-step_s / lag_s))
    lasts = min(len(x), int(np.ceil(_FORGOTTEN * lag_s / step_s)))
    ends = _convolved(x - x[0], np.asarray((1.0 - keep) * keep ** np.arange(lasts)[:, None], float))[: len(x)]
    begins = np.vstack([np.zeros((1, x.shape[1])), ends[:-1]])
    return np.asarray(x[0] + (begins + ends) / 2.0, float)
