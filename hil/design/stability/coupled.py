"""The sampled loop of six axes whose forces move all of them: laws that do not linearise the robot.

Linear, so true for small errors around one pose.
"""

from functools import partial
from math import inf, pi

import numpy as np

from drivers.arrays import Array, ComplexArray
from hil.design.stability.sampled import Axis
from hil.design.stability.sampled_loop import late_states, root
from hil.mathematics.linear_system import LinearSystem, static


def proportional(K_p: Array, K_v: Array, period_s: float) -> LinearSystem:
    """Return f = K_p e + K_v de of six axes, gains (6,), as a controller from [e; de] to forces."""
    return static(np.hstack([np.diag(K_p), np.diag(K_v)]), period_s)


def integrating(K_p: Array, K_v: Array, K_i: Array, period_s: float) -> LinearSystem:
    """Return f = K_p e + K_v de + xi, dxi/dt = K_i e by Euler's rule, as `hil.control.pid` has it."""
    rise = np.hstack([period_s * np.diag(K_i), np.zeros((6, 6))])
    D = np.hstack([np.diag(K_p), np.diag(K_v)]) + rise
    return LinearSystem(np.eye(6), rise, np.eye(6), D, period_s)


def growth(axis: Axis, controller: LinearSystem, mobility: Array, stiffness: Array | None = None) -> float:
    """Return the largest |z| of the loop: below 1 it is stable.

    mobility (6, 6): acceleration of the axes per force of each, J M^-1 J^T for legs, M^-1 for a pose.
    stiffness (6, 6): of the axes themselves, which answers at once: springs, weight. None: there is none.
    """
    plant = _axes(axis, mobility, stiffness)
    loop = plant._replace(C=-plant.C).closed_with(controller)
    return float(np.abs(loop.poles()).max())


def _axes(axis: Axis, mobility: Array, stiffness: Array | None) -> LinearSystem:
    """Return the axes from forces, held and late, to positions and rates."""
    slow = axis.lag_s > 0.0
    n = 18 if slow else 12
    A, B = np.zeros((n, n)), np.zeros((n, 6))  # of positions, rates, and the drives
    A[:6, 6:12] = np.eye(6)
    if stiffness is not None:
        A[6:12, :6] = -mobility @ stiffness
    (A if slow else B)[6:12, -6:] = axis.gain * mobility
    if slow:
        A[12:, 12:], B[12:] = -np.eye(6) / axis.lag_s, np.eye(6) / axis.lag_s
    return late_states(A, B, 12, axis.transport_s, axis.period_s)


def delay_margin_s(
    axis: Axis, controller: LinearSystem, mobility: Array, stiffness: Array | None = None
) -> float:
    """Return the further delay of all axes at which a stable loop turns unstable, s; inf where none does.

    A common delay turns all eigenvalues of the loop's frequency response by the same angle: the least margin
    of these characteristic loci is the loop's (A. G. J. MacFarlane and I. Postlethwaite, 1977). The axes'
    own resonances are below half the rate, see `resonances`.
    """
    plant = _axes(axis, mobility, stiffness)

    def loci(omega: Array) -> ComplexArray:
        """Return the eigenvalues (n, 6), the largest first."""
        values = np.asarray(
            np.linalg.eigvals(controller.response(omega) @ plant.response(omega)), np.complex128
        )
        return np.take_along_axis(values, np.argsort(-np.abs(values), axis=1), axis=1)

    def at(omega: float, k: int) -> complex:
        return complex(loci(np.array([omega]))[0, k])

    def beyond(k: int, omega: float) -> float:
        return abs(at(omega, k)) - 1.0

    omega = np.geomspace(1e-4, 1.0, 1500) * pi / axis.period_s
    if stiffness is not None:  # narrow peaks, which no grid meets
        peaks = resonances(mobility, stiffness)
        omega = np.sort(np.concatenate([omega, *(peaks * near for near in (1.0 - 1e-7, 1.0 + 1e-7))]))
    size = np.abs(loci(omega))
    margin = inf
    for i, k in np.argwhere(np.diff(np.sign(size - 1.0), axis=0) != 0):
        w = root(partial(beyond, k), omega[i], omega[i + 1])
        margin = min(margin, (float(np.angle(at(w, k))) + pi) / w)
    return margin


def resonances(mobility: Array, stiffness: Array) -> Array:
    """Return the frequencies, rad/s, at which the axes swing by themselves."""
    squares = np.linalg.eigvals(mobility @ stiffness).real
    return np.asarray(np.sqrt(squares[squares > 0.0]), np.float64)
