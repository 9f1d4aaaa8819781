"""The Lyapunov function of linear error dynamics, axis by axis, in closed form.

::

    e'' + K_D e' + K_P e = d,   x = [e; de],   dx/dt = A x + B d,   A = [0 1; -K_P -K_D],   B = [0; 1]

e is reference minus measurement, m or rad. d is the unmodelled acceleration of the axis, m/s^2 or rad/s^2;
its sign does not affect a bound.
"""

from math import sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from drivers.arrays import Array
from drivers.errors import ModelError


class Certificate(NamedTuple):
    """Lyapunov function V = x^T P x of six axes, for every solution and every disturbance d.

    ::

        dV/dt <= -2 alpha (V - d^2)

    Without disturbance V decays as exp(-2 alpha t), x as exp(-alpha t). Under |d| <= d_max V decreases
    wherever it is above d_max^2: states below stay below, all others come below. V is in (m/s^2)^2
    or (rad/s^2)^2. If V does not decrease, the disturbance of the axis is at least sqrt(V).
    """

    K_P: Array
    """(6,) 1/s^2, gain of the error of each axis."""
    K_D: Array
    """(6,) 1/s, gain of the rate error of each axis."""
    alpha: Array
    """(6,) 1/s, guaranteed decay rate of x on each axis."""
    P: Array
    """(6, 2, 2), matrix of V = x^T P x on each axis: symmetric, positive definite."""


def certificate(K_P: ArrayLike, K_D: ArrayLike) -> Certificate:
    """Certificate of six axes with K_P (6,) 1/s^2 and K_D (6,) 1/s, or one for all.

    P is the inverse of W, the solution of the Lyapunov equation of the reachable ellipsoid (S. Boyd,
    L. El Ghaoui, E. Feron and V. Balakrishnan, Linear Matrix Inequalities in System and Control Theory,
    1994, 6.1.3)

        (A + alpha I) W + W (A + alpha I)^T + B B^T / (2 alpha) = 0

    For these A and B, with c = K_P - alpha K_D + alpha^2,

        V = 4 alpha (K_D - 2 alpha) ((de + alpha e)^2 + c e^2)

    alpha of each axis gives the smallest bound on |e| (`tightest_alpha`).

    Raises ModelError for an axis that is not stable.
    """
    stiffness, damping = (np.broadcast_to(np.asarray(K, float), (6,)).copy() for K in (K_P, K_D))
    alpha = np.array(
        [tightest_alpha(p, d) for p, d in zip(stiffness.tolist(), damping.tolist(), strict=True)]
    )
    P = np.empty((6, 2, 2))
    P[:, 0, 0] = (stiffness - alpha * damping + alpha * alpha) + alpha * alpha
    P[:, 0, 1] = P[:, 1, 0] = alpha
    P[:, 1, 1] = 1.0
    P *= (4.0 * alpha * (damping - 2.0 * alpha))[:, None, None]
    for array in (stiffness, damping, alpha, P):
        array.flags.writeable = False
    return Certificate(stiffness, damping, alpha, P)


def decay_rate(K_P: float, K_D: float) -> float:
    """Decay rate of the slowest solution of e'' + K_D e' + K_P e = 0, 1/s: -max Re of its two poles.

    Raises ModelError if it does not decay.
    """
    if not (K_P > 0.0 and K_D > 0.0):
        raise ModelError(
            f"K_P {K_P:g} 1/s^2 and K_D {K_D:g} 1/s, allowed: both above 0, else the error grows"
        )
    half, square = K_D / 2.0, K_D * K_D / 4.0 - K_P
    return half if square <= 0.0 else K_P / (half + sqrt(square))


def tightest_alpha(K_P: float, K_D: float) -> float:
    """alpha, 1/s, of the smallest reachable ellipsoid along e.

    1 / W_11 = 4 alpha (K_D - 2 alpha) (K_P - alpha K_D + alpha^2) has one maximum between 0 and the decay
    rate; with u = alpha - K_D / 2 and kappa = K_P - K_D^2 / 4 its derivative vanishes where
    4 u^3 + 3/2 K_D u^2 + 2 kappa u + kappa K_D / 2 = 0. At critical damping alpha = wn / 4, and
    |e| <= sqrt(32 / 27) d_max / wn^2, 8.9 % above the smallest possible bound.
    """
    kappa = K_P - K_D * K_D / 4.0
    low, high = 0.0, decay_rate(K_P, K_D)
    for _ in range(200):
        middle = (low + high) / 2.0
        u = middle - K_D / 2.0
        rises = ((4.0 * u + 1.5 * K_D) * u + 2.0 * kappa) * u + kappa * K_D / 2.0 < 0.0
        low, high = (middle, high) if rises else (low, middle)
    return (low + high) / 2.0
