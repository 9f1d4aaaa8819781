"""The sampled loop of six axes whose forces move all of them: laws that do not linearise the robot.

Rule of the room: pure; offline (LAPACK is used). Linear, so true for small errors around one pose.
"""

from __future__ import annotations

from functools import reduce
from math import inf

import numpy as np
from scipy.optimize import brentq

from hil.linear_system import LinearSystem, static
from hil.signals import Array
from hil.stability.sampled import Axis, sampled_axis

LONGEST_DELAY_S = 1.0
"""A loop that bears this further delay bears any that matters."""


def proportional(K_p: Array, K_v: Array, period_s: float) -> LinearSystem:
    """Return f = K_p e + K_v de of six axes, gains (6,), as a controller from [e; de] to forces."""
    return static(np.hstack([np.diag(K_p), np.diag(K_v)]), period_s)


def integrating(K_p: Array, K_v: Array, K_i: Array, period_s: float) -> LinearSystem:
    """Return f = K_p e + K_v de + xi, dxi/dt = K_i e by Euler's rule, as `hil.control.pid` has it."""
    rise = np.hstack([period_s * np.diag(K_i), np.zeros((6, 6))])
    D = np.hstack([np.diag(K_p), np.diag(K_v)]) + rise
    return LinearSystem(np.eye(6), rise, np.eye(6), D, period_s)


def growth(axis: Axis, controller: LinearSystem, mobility: Array) -> float:
    """Return the largest |z| of the loop: below 1 it is stable.

    mobility (6, 6): acceleration of the axes per force of each, J M^-1 J^T for legs, M^-1 for a pose.
    """
    one = sampled_axis(axis)
    undisturbed = one._replace(B=one.B[:, :1], D=one.D[:, :1])
    plant = reduce(lambda left, right: left.beside(right), [undisturbed] * 6)
    order = [*range(0, 12, 2), *range(1, 12, 2)]  # positions, then rates
    y = -plant.C[order]
    forces = LinearSystem(
        controller.A, controller.B, mobility @ controller.C, mobility @ controller.D, controller.period_s
    )
    loop = LinearSystem(plant.A, plant.B, y, np.zeros((12, 6)), plant.period_s).closed_with(forces)
    return float(np.abs(loop.poles()).max())


def delay_margin_s(axis: Axis, controller: LinearSystem, mobility: Array) -> float:
    """Return the further delay at which a stable loop turns unstable, s; inf beyond `LONGEST_DELAY_S`."""

    def excess(further: float) -> float:
        return growth(axis._replace(transport_s=axis.transport_s + further), controller, mobility) - 1.0

    low, high = 0.0, axis.period_s
    while excess(high) < 0.0:
        low, high = high, 2.0 * high
        if high > LONGEST_DELAY_S:
            return inf
    return float(brentq(excess, low, high, xtol=1e-2 * axis.period_s))
