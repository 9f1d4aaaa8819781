"""Probe forces: a push decides whether a leg whose reading stands still is held by friction.

A stage between the law and the limits. Safety reports the legs that stand still while they or others stray
from the reference, and counts a leg that does not move under its push. The limits apply to the sum of law and
push.

Without friction a leg is pushed at once, gently, one way and then the other. Friction holds a leg as long as
the acting force F stays within

    onset(load - friction, -1) <= F <= onset(load + friction, 1)
    onset(X, s) = X / eta_d where X s > 0 (the motor drives the leg), else X eta_b,

load: force from inverse dynamics along the reference, at the measured pose. Only friction that is configured
or identified counts. Beyond that band a free leg would move. As soon as it would have moved visibly, the leg
is pushed that way by at least twice the friction. A leg that stands for another reason, or under up to three
times that friction, then moves.

The load may differ from the model's. In motion a frozen reading strays from its reference, and the law's
force shows it; at rest it does not. At rest, if the force on any leg, less the part that accelerates the
legs, is beyond its band, the band of a standing leg shows nothing: it is pushed, too. While such a load acts,
one push decides nothing, as the load may hold the leg against it: a push the other way follows.
"""

from math import copysign
from typing import Any

import numpy as np

from drivers.arrays import Array
from drivers.compiled.compiler import helper
from drivers.compiled.pointed import reals_at
from drivers.signals import LEGS
from hil.mathematics.linear_algebra import lu_factor, lu_solve
from hil.robot.dynamics_kernels import FULL, SIZE, inverse_dynamics_kernel
from hil.safety.residuals import MOVED

KNOWN = 0.02
"""Relative uncertainty of the load of a leg."""
KNOWN_INERTIA = 0.2
"""Relative uncertainty of the force of an acceleration."""
LEAST_S, LONGEST_S = 0.01, 0.05
"""Shortest and longest time for which forces are compared with the load."""


@helper
def look(tick: Any, limits: Any, memory: Any, window: Array, robot: int, senses_wrench: int) -> None:
    """Decide for each leg whose reading stands still whether a probe push starts, continues or ends.

    limits, memory: records of `hil.safety.kernels`; window: the forces sent, (n, 6) N, see
    `hil.safety.force_limits`; robot: address of the constants of the load model, see
    `hil.robot.dynamics_kernels`; senses_wrench: not 0 if a sensor gives the external wrench. An observer's
    wrench does not count: to an observer, a leg that stands under a force seems loaded.
    """
    c, wrench = reals_at(robot, SIZE), np.zeros(6)
    if senses_wrench:
        wrench[:] = tick.wrench
    load = inverse_dynamics_kernel(c, FULL, tick.p, tick.R, tick.twist, tick.dtwist_d, wrench)
    acting = window[(memory.newest - limits.acting_ticks) % limits.window_ticks]
    rests = np.abs(tick.dq_d).max() * LEAST_S <= limits.length_noise_m
    is_unknown = weigh(tick, limits, memory, c, load, acting, wrench)
    is_young = memory.weighed * limits.period_s < LEAST_S
    for i in range(LEGS):
        if not memory.strays >> i & 1:
            continue
        excess = beyond(
            acting[i],
            load[i],
            limits.friction_N + KNOWN * abs(load[i]),
            limits.driving[i],
            limits.back_driving[i],
        )
        if memory.push[i] != 0:
            way = 1 if memory.push[i] > 0 else -1
            if abs(memory.push[i]) == limits.push_ticks and (is_unknown or is_young):
                memory.both_ways |= 1 << i
            if abs(memory.push[i]) < limits.push_ticks or memory.both_ways >> i & 1 or excess * way > 0.0:
                memory.push[i] += way
                continue
            memory.push[i] = 0  # the law works against it: the push proves nothing
        if excess == 0.0 or memory.free_m[i] * excess < 0.0:
            memory.free_m[i] = memory.free_m_s[i] = 0.0
        memory.free_m_s[i] += excess * limits.mobility_low[i] * limits.period_s
        memory.free_m[i] += memory.free_m_s[i] * limits.period_s
        if abs(memory.free_m[i]) > MOVED * limits.length_noise_m:
            memory.push[i] = 1 if memory.free_m[i] > 0.0 else -1
        elif is_unknown and rests:
            memory.push[i] = 1 if excess >= 0.0 else -1
        memory.both_ways &= ~(1 << i)


@helper
def weigh(tick: Any, limits: Any, memory: Any, c: Array, load: Array, acting: Array, wrench: Array) -> bool:
    """True if a load acts that the model does not know; adds the force of the legs' acceleration to `load`.

    Compares means since legs began to stray, N: the acting force, less the load, less the force that changed
    the rates r of the legs,

        J^-T M J^-1 (r - r_then) / T,    r = dq - dq_d.
    """
    if memory.weighed_tick != tick.tick or memory.weighed * limits.period_s >= LONGEST_S:
        memory.weighed = 0
        memory.impulse[:] = 0.0
        for i in range(LEGS):
            memory.rate_then[i] = tick.rate[i] - tick.dq_d[i]
    memory.weighed_tick = tick.tick + 1
    memory.weighed += 1
    for i in range(LEGS):
        memory.impulse[i] += (acting[i] - load[i]) * limits.period_s
    T = memory.weighed * limits.period_s
    if T < LEAST_S:
        return False
    changed, LU, order = np.empty(6), np.empty((6, 6)), np.empty(6, np.int64)
    if not lu_factor(tick.J, LU, order):
        return True
    lu_solve(LU, order, (tick.rate - tick.dq_d - memory.rate_then) / T, changed)
    moved = inverse_dynamics_kernel(c, FULL, tick.p, tick.R, tick.twist, tick.dtwist_d + changed, wrench)
    is_unknown = False
    for i in range(LEGS):
        takes = moved[i] - load[i]
        force = load[i] + memory.impulse[i] / T - takes
        friction = limits.friction_N + KNOWN * abs(load[i]) + KNOWN_INERTIA * abs(takes)
        if beyond(force, load[i], friction, limits.driving[i], limits.back_driving[i]) != 0.0:
            is_unknown = True
        load[i] = moved[i]
    return is_unknown


@helper
def beyond(force: float, load: float, friction: float, driving: float, back_driving: float) -> float:
    """Force, N, in excess of what friction can hold at a load, N; 0: friction may hold the leg."""
    high, low = load + friction, load - friction
    high = high / driving if high > 0.0 else high * back_driving
    low = low / driving if low < 0.0 else low * back_driving
    return max(force - high, 0.0) + min(force - low, 0.0)


@helper
def fill_probe(tick: Any, last: Any, limits: Any, memory: Any) -> bool:
    """Fill in probe_force, (6,) N, > 0 extends, from that of the last tick; True if a push starts."""
    begins = False
    for i in range(LEGS):
        rise, ticks = limits.rise_ticks, limits.push_ticks
        force = push_of(memory.push[i], ticks, limits.push_N[i], limits.sticks != 0, rise)
        most = limits.push_N[i] / rise if limits.sticks != 0 else 2.0 * limits.push_N[i] / max(ticks, 1)
        was = last.probe_force[i]
        tick.probe_force[i] = min(max(force, was - most), was + most)
        begins = begins or (was == 0.0 and abs(memory.push[i]) == 1)
    return begins


@helper
def push_of(pushed: int, ticks: int, force: float, sticks: bool, rise: int) -> float:
    """Probe force of a leg, N; 0 for a leg that is not pushed.

    It pushes `ticks` ticks one way, then the other: along straight lines, or, with friction, by the full
    force after a rise of `rise` ticks; 1: at once.
    """
    if pushed == 0:
        return 0.0
    first, k = copysign(force, pushed), abs(pushed)
    if sticks and k > ticks:
        first, k = -first, k - ticks
    if sticks:
        return first * min(k / rise, 1.0)
    return first * min(2 * k, ticks, max(3 * ticks - 2 * k, -ticks)) / ticks
