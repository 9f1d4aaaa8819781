"""The sampled loop of six axes whose forces move all of them: laws that do not linearise the robot.

Linear, so true for small errors around one pose.
"""

from functools import reduce
from math import inf, pi

import numpy as np
from scipy.optimize import brentq

from drivers.arrays import Array, ComplexArray
from hil.mathematics.linear_system import LinearSystem, lag, static
from hil.stability.sampled import Axis
from hil.stability.sampled_loop import sampled_axis


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
    one = sampled_axis(axis.transport_s, lag(axis.lag_s), axis.period_s, axis.gain)
    plant = reduce(lambda left, right: left.beside(right), [one] * 6)
    order = [*range(0, 12, 2), *range(1, 12, 2)]  # positions, then rates
    y = -plant.C[order]
    forces = LinearSystem(
        controller.A, controller.B, mobility @ controller.C, mobility @ controller.D, controller.period_s
    )
    loop = LinearSystem(plant.A, plant.B, y, np.zeros((12, 6)), plant.period_s).closed_with(forces)
    return float(np.abs(loop.poles()).max())


def delay_margin_s(axis: Axis, controller: LinearSystem, mobility: Array) -> float:
    """Return the further delay of all axes at which a stable loop turns unstable, s; inf where none does.

    A common delay turns all eigenvalues of the loop's frequency response by the same angle: the least margin
    of these characteristic loci is the loop's (A. G. J. MacFarlane and I. Postlethwaite, 1977).
    """
    plant = sampled_axis(axis.transport_s, lag(axis.lag_s), axis.period_s, axis.gain)

    def loci(omega: Array) -> ComplexArray:
        """Return the eigenvalues (n, 6), the largest first."""
        axes = np.kron(plant.response(omega), np.eye(6))
        values = np.asarray(np.linalg.eigvals(mobility @ controller.response(omega) @ axes), np.complex128)
        return np.take_along_axis(values, np.argsort(-np.abs(values), axis=1), axis=1)

    def at(omega: float, k: int) -> complex:
        return complex(loci(np.array([omega]))[0, k])

    omega = np.geomspace(1e-4, 1.0, 1500) * pi / axis.period_s
    size = np.abs(loci(omega))
    margin = inf
    for i, k in np.argwhere(np.diff(np.sign(size - 1.0), axis=0) != 0):
        w = float(brentq(lambda w, k=k: abs(at(w, k)) - 1.0, omega[i], omega[i + 1]))
        margin = min(margin, (float(np.angle(at(w, k))) + pi) / w)
    return margin
