"""What a loop loses along a moving reference because its forces are late: by transport, hold and lag.

A linearising law computes the force for the state that was measured; what acts is the force of some
milliseconds ago. Along the reference that disturbs the axes by

::

    d = J M^-1 J^T (tau_a - tau),   tau_a: tau(t_k + ahead) from t_k + transport on, held, then the lag

which is known, so its response is computed, not bounded: a jump of tau counts by its area, age times height.
When the jump comes between two measurements t_k decides on its age: several such instants are looked at.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.signal import fftconvolve, lfilter

from drivers.arrays import Array
from hil.stability.disturbance import Linearised
from hil.stability.sampled import Axis, Sampled
from hil.trajectory.path import Trajectory

_SAMPLES = 3000
"""Of the forces along the reference, at most; between them they change in proportion."""
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
    span_s: float,
    axis: Axis,
    loops: Sequence[Sampled],
    ahead_s: float,
) -> Late:
    """Return what being late costs along `span_s` of a reference, by the response of each axis' loop.

    ahead_s: how far the law looks ahead.
    """
    T = axis.period_s
    end = min(span_s + max(loop.steps for loop in loops) * T, 2.0 * span_s + 1.0)
    t = np.arange(-T, end, T / _PARTS) + T / (2 * _PARTS)
    times = np.linspace(t[0] - 0.1, end + 0.1, min(_SAMPLES, len(t)))
    found = [linearised.along_reference(reference.sample(float(at))) for at in times]
    tau = np.array([force for force, _ in found])
    acts = _between(t, times, np.array([matrix for _, matrix in found]))
    wanted = _between(t, times, tau)
    worst = np.zeros((3, 6))
    responses = [loop.impulse_responses() for loop in loops]
    for phase in _PHASES:
        measured = (np.floor((t - axis.transport_s) / T - phase) + phase) * T
        real = _lagged(_between(measured + ahead_s, times, tau), axis.lag_s, T / _PARTS)
        d = np.einsum("tij,tj->ti", acts, real - wanted)
        whole = len(d) // _PARTS * _PARTS
        d = d[:whole].reshape(-1, _PARTS, 6).mean(axis=1)
        for i, h in enumerate(responses):
            answers = fftconvolve(d[:, i, None], h, axes=0)[: len(d)]
            worst[:, i] = np.maximum(worst[:, i], np.abs(answers).max(axis=0))
    return Late(worst[0], worst[1], worst[2], stale_s(axis, ahead_s))


def _between(t: Array, times: Array, values: Array) -> Array:
    """Return values (n, ...) at even `times` (n,) for other times t, in proportion; beyond, the nearest."""
    place = np.clip((t - times[0]) / (times[1] - times[0]), 0.0, len(times) - 1.0)
    k = np.minimum(place.astype(int), len(times) - 2)
    share = (place - k).reshape(-1, *[1] * (values.ndim - 1))
    return np.asarray((1.0 - share) * values[k] + share * values[k + 1], float)


def _lagged(x: Array, lag_s: float, step_s: float) -> Array:
    """Return what a first-order lag makes of x (n, 6), from rest, in the middle of each step."""
    if lag_s == 0.0:
        return x
    keep = float(np.exp(-step_s / lag_s))
    ends, _ = lfilter([1.0 - keep], [1.0, -keep], x - x[0], axis=0, zi=np.zeros((1, x.shape[1])))
    begins = np.vstack([np.zeros((1, x.shape[1])), ends[:-1]])
    return np.asarray(x[0] + (begins + ends) / 2.0, float)
