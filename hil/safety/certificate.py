"""Certificate check: the Lyapunov function V of the tracking error grows no faster than disturbances allow.

Derived in docs/theory/monitor.md. The stated disturbance is at most D.

::

    W = sqrt(V),  dW/dt <= g D,  dV/dt <= -2 alpha (V - D^2)      under |d| <= D, g = sqrt(P_22)
    bound(k + 1) = min(level(k) + g D T, sqrt(a level(k)^2 + (1 - a) D^2)),  a = exp(-2 alpha T)
    level(k) = min(bound(k), W(k) + noise)

for each axis: `bound` is the smallest bound that follows from any tick since the check started. The axis
violates its certificate where W - noise > bound.
"""

from math import nan, sqrt
from typing import Any, NamedTuple

import numpy as np

from drivers.arrays import Array
from drivers.compiled.compiler import helper

(
    K_P, K_D, P_11, P_12, P_22, DISTURBANCE, NOISE, RISE, DECAY, SLOPE, STEEPNESS, SCALARS, CONSTANTS,
) = range(13)  # fmt: skip
"""Rows of the constants of a watch (CONSTANTS, 6), see `hil.design.stability.monitor`: the certificate; the
disturbance in m/s^2 or rad/s^2, enlarged for a law that predicts; the noise of W; g T and exp(-2 alpha T);
slope and steepness of a boundary layer."""
POSE, SHARED, LAYER, ACTION, CONFIRM, PERIOD = range(6)
"""SCALARS: axes of the pose; one layer for all legs; thickness of the layer; action; ticks to confirm;
period, s."""
LEVEL, COUNT, PAST, REFERENCE, ASKED = 0, 1, 2, 3, 6
"""Rows of the memory: level and ticks of violation of each axis; PAST; q_d, dq_d, ddq_d of the last tick;
from ASKED on the accelerations that the law asked for, newest first."""
LAST_V, UNREST = range(2)
"""PAST: V of the last tick, nan without one; ticks until the forces are the law's and the lengths are
measured."""


class Watch(NamedTuple):
    """Constants of the certificate check, computed by `hil.design.stability.monitor`."""

    constants: Array
    """Constants (CONSTANTS, 6), see the rows above; (0, 6): no certificate check."""
    ticks: int
    """Number of ticks whose requested forces may act at once."""


NO_WATCH = Watch(np.zeros((0, 6)), 0)


@helper
def grown(level: float, disturbance: float, rise: float, decay: float) -> float:
    """Largest W = sqrt(V) one period after W <= level; rise = g T, decay = exp(-2 alpha T)."""
    settled = decay * level * level + (1.0 - decay) * disturbance * disturbance
    return min(level + rise * disturbance, sqrt(settled))


@helper
def lyapunov(constants: Array, i: int, e: float, de: float) -> float:
    """Lyapunov function V of axis i at error e (m or rad) and its derivative de."""
    mixed = 2.0 * constants[P_12, i] * e * de
    value: float = constants[P_11, i] * e * e + mixed + constants[P_22, i] * de * de
    return max(value, 0.0)


@helper
def asked_for(constants: Array, e: Array, de: Array, feed: Array, linear: Array, asked: Array) -> None:
    """Fill in axis accelerations, m/s^2 or rad/s^2: `linear` by the certified gains, `asked` by the law.

    linear = feed + K_P e + K_D de; sigma = de + slope e. Where |sigma| (over all legs if they share a layer)
    exceeds the boundary layer, `asked` is smaller by steepness (|sigma| - layer) along sigma.
    """
    layer = constants[SCALARS, LAYER]
    square = 0.0
    for i in range(6):
        sigma = de[i] + constants[SLOPE, i] * e[i]
        square += sigma * sigma
    for i in range(6):
        linear[i] = feed[i] + constants[K_P, i] * e[i] + constants[K_D, i] * de[i]
        sigma = de[i] + constants[SLOPE, i] * e[i]
        size = sqrt(square) if constants[SCALARS, SHARED] > 0.0 else abs(sigma)
        beyond = 1.0 - layer / size if size > layer else 0.0
        asked[i] = linear[i] - constants[STEEPNESS, i] * sigma * beyond


@helper
def jumped(constants: Array, memory: Array, q_d: Array, dq_d: Array, ddq_d: Array) -> bool:
    """True if the change of the reference since the last tick does not follow from its own rates.

    q_d m, dq_d m/s, ddq_d m/s^2, each (6,). Tolerance: the motion of a leg under the disturbance within a
    period; a jump of the acceleration alone may stay within it.
    """
    T = constants[SCALARS, PERIOD]
    for i in range(6):
        slip = dq_d[i] - memory[REFERENCE + 1, i] - 0.5 * T * (ddq_d[i] + memory[REFERENCE + 2, i])
        gap = q_d[i] - memory[REFERENCE, i] - 0.5 * T * (dq_d[i] + memory[REFERENCE + 1, i])
        allowed = T * constants[DISTURBANCE, 0]
        if abs(slip) > allowed or abs(gap) > T * allowed:
            return True
    return False


@helper
def spread(memory: Array, i: int, linear: float) -> float:
    """Largest difference, m/s^2 or rad/s^2, of `linear` from the requested accelerations acting now."""
    widest = 0.0
    for k in range(ASKED, memory.shape[0]):
        widest = max(widest, abs(linear - memory[k, i]))
    return widest


@helper
def remember_reference(memory: Array, q_d: Array, dq_d: Array, ddq_d: Array) -> None:
    """Store the reference of this tick, (6,) lengths m, rates m/s, accelerations m/s^2."""
    memory[REFERENCE] = q_d
    memory[REFERENCE + 1] = dq_d
    memory[REFERENCE + 2] = ddq_d


@helper
def remember_asked(memory: Array, asked: Array, fresh: bool) -> None:
    """Store the law's requested accelerations (6,); `fresh`: also for all earlier ticks."""
    for k in range(memory.shape[0] - 1, ASKED, -1):
        memory[k] = asked if fresh else memory[k - 1]
    memory[ASKED] = asked


@helper
def forget(memory: Array) -> None:
    """Reset the certificate check: its next tick starts a new comparison."""
    memory[COUNT] = 0.0
    memory[PAST, LAST_V] = nan
    memory[PAST, UNREST] = 0.0


@helper
def settle(memory: Array, limited: bool) -> None:
    """Pause the certificate check if a limit changed the forces, until these no longer act."""
    memory[PAST, UNREST] = memory.shape[0] - ASKED if limited else max(memory[PAST, UNREST] - 1.0, 0.0)


@helper
def unsettle(memory: Array) -> None:
    """Pause the check for a tick, as the error came from an estimate and not from readings."""
    memory[PAST, UNREST] = max(memory[PAST, UNREST], 2.0)  # one of which `settle` takes off in this tick


@helper
def watch(
    constants: Array, memory: Array, e: Array, de: Array, rate: Array, feed: Array,
    whole: bool, late_s: float, periods: float, tick: Any,
) -> bool:  # fmt: skip
    """Fill in V, its rate, the allowed V and the largest W / (bound + noise) of a tick.

    Returns True if an axis has violated its certificate for the configured number of ticks.

    e, de, and rate and acceleration of the reference as in `hil.safety.error_axes`. whole: nothing outside
    the certificate's model has happened since the last tick; otherwise the check restarts. late_s: delay of
    the encoder readings; periods: since the last tick.
    """
    fresh = bool(np.isnan(memory[PAST, LAST_V]))
    begins = fresh or not whole
    linear, asked = np.empty_like(e), np.empty_like(e)
    asked_for(constants, e, de, feed, linear, asked)
    total, bounds, share = 0.0, 0.0, 0.0
    broken = False
    for i in range(6):
        value = lyapunov(constants, i, e[i], de[i])
        W = sqrt(value)
        pushed = abs(feed[i]) + constants[DISTURBANCE, i]
        moved = sqrt(constants[P_11, i]) * abs(rate[i]) + sqrt(constants[P_22, i]) * pushed
        noise = constants[NOISE, i] + moved * late_s
        total += value
        if begins:
            memory[LEVEL, i] = W + noise
            memory[COUNT, i] = 0.0
            continue
        disturbance = constants[DISTURBANCE, i] + spread(memory, i, linear[i])
        bound = grown(memory[LEVEL, i], disturbance, constants[RISE, i], constants[DECAY, i])
        bounds += bound * bound
        share = max(share, W / (bound + noise))
        memory[COUNT, i] = memory[COUNT, i] + 1.0 if W - noise > bound else 0.0
        memory[LEVEL, i] = min(bound, W + noise)
        if memory[COUNT, i] >= constants[SCALARS, CONFIRM]:
            broken = True
    remember_asked(memory, asked, fresh)
    tick.lyapunov = total
    tick.lyapunov_rate = (total - memory[PAST, LAST_V]) / (constants[SCALARS, PERIOD] * periods)
    tick.lyapunov_bound = nan if begins else bounds
    tick.lyapunov_share = nan if begins else share
    memory[PAST, LAST_V] = total
    return broken
