"""The Lyapunov function of linear error dynamics, axis by axis, in closed form.

::

    e'' + K_D e' + K_P e = d,   x = [e; de],   dx/dt = A x + B d,   A = [0 1; -K_P -K_D],   B = [0; 1]

e is demanded minus measured, m or rad, and d the acceleration of the axis, m/s^2 or rad/s^2, that the law
does not know (its sign is of no consequence to a bound).
"""

from math import sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from drivers.arrays import Array
from drivers.errors import ModelError


class Certificate(NamedTuple):
    """V = x^T P x of six axes; along every solution, under every disturbance d.

    ::

        dV/dt <= -2 alpha (V - d^2)

    Without disturbance V decays as exp(-2 alpha t), x as exp(-alpha t). Under |d| <= d_max V falls wherever
    it is above d_max^2: what began below stays below, everything else comes there. V is in (m/s^2)^2 or
    (rad/s^2)^2: where it does not fall, the axis is under a disturbance of sqrt(V) at least.
    """

    K_P: Array
    """(6,) 1/s^2."""
    K_D: Array
    """(6,) 1/s."""
    alpha: Array
    """(6,) 1/s."""
    P: Array
    """(6, 2, 2), symmetric, positive definite."""

    def V(self, e: Array, de: Array) -> Array:
        """Return V (6,) of each axis at e (6,) m or rad and de (6,)."""
        P = self.P
        return P[:, 0, 0] * e * e + 2.0 * P[:, 0, 1] * e * de + P[:, 1, 1] * de * de

    def dV(self, e: Array, de: Array, d: Array) -> Array:
        """Return dV/dt (6,) of each axis at e, de under the acceleration d (6,), d = e'' + K_D de + K_P e."""
        P = self.P
        dde = d - self.K_D * de - self.K_P * e
        return 2.0 * ((P[:, 0, 0] * e + P[:, 0, 1] * de) * de + (P[:, 0, 1] * e + P[:, 1, 1] * de) * dde)

    def error_gain(self) -> Array:
        """Return max |e| on V <= 1, (6,) s^2: |e| <= gain d_max in the end, and always from x(0) = 0."""
        return np.sqrt(self.P[:, 1, 1] / self._determinant())

    def rate_gain(self) -> Array:
        """Return max |de| on V <= 1, (6,) s: |de| <= gain d_max likewise."""
        return np.sqrt(self.P[:, 0, 0] / self._determinant())

    def _determinant(self) -> Array:
        return self.P[:, 0, 0] * self.P[:, 1, 1] - self.P[:, 0, 1] ** 2


def certificate(K_P: ArrayLike, K_D: ArrayLike, alpha: float | None = None) -> Certificate:
    """Return the certificate of six axes, K_P (6,) 1/s^2 and K_D (6,) 1/s, or one for all.

    P is the inverse of W, the solution of the Lyapunov equation of the reachable ellipsoid (S. Boyd,
    L. El Ghaoui, E. Feron and V. Balakrishnan, Linear Matrix Inequalities in System and Control Theory,
    1994, 6.1.3)

        (A + alpha I) W + W (A + alpha I)^T + B B^T / (2 alpha) = 0

    which for these A and B is, with c = K_P - alpha K_D + alpha^2,

        V = 4 alpha (K_D - 2 alpha) ((de + alpha e)^2 + c e^2)

    By default alpha is that of the smallest bound on |e|, of each axis (`tightest_alpha`).

    Raises ModelError where an axis is not stable, or does not decay as fast as alpha.
    """
    stiffness, damping = (np.broadcast_to(np.asarray(K, float), (6,)).copy() for K in (K_P, K_D))
    rates, P = np.empty(6), np.empty((6, 2, 2))
    for i in range(6):
        k_p, k_d = float(stiffness[i]), float(damping[i])
        slowest = decay_rate(k_p, k_d)
        a = tightest_alpha(k_p, k_d) if alpha is None else alpha
        if not 0.0 < a < slowest:
            raise ModelError(
                f"axis {i}: alpha {a:g} 1/s, allowed: above 0 and below the decay rate {slowest:.6g} 1/s"
            )
        c = k_p - a * k_d + a * a
        rates[i] = a
        P[i] = 4.0 * a * (k_d - 2.0 * a) * np.array([[c + a * a, a], [a, 1.0]])
    for array in (stiffness, damping, rates, P):
        array.flags.writeable = False
    return Certificate(stiffness, damping, rates, P)


def decay_rate(K_P: float, K_D: float) -> float:
    """Return how fast the slowest solution of e'' + K_D e' + K_P e = 0 decays, 1/s: -max Re of its two poles.

    Raises ModelError where it does not decay.
    """
    if not (K_P > 0.0 and K_D > 0.0):
        raise ModelError(
            f"K_P {K_P:g} 1/s^2 and K_D {K_D:g} 1/s, allowed: both above 0, else the error grows"
        )
    half, square = K_D / 2.0, K_D * K_D / 4.0 - K_P
    return half if square <= 0.0 else K_P / (half + sqrt(square))


def tightest_alpha(K_P: float, K_D: float) -> float:
    """Return the alpha, 1/s, of the smallest reachable ellipsoid along e.

    1 / W_11 = 4 alpha (K_D - 2 alpha) (K_P - alpha K_D + alpha^2) has one maximum between 0 and the decay
    rate; with u = alpha - K_D / 2 and kappa = K_P - K_D^2 / 4 its derivative vanishes where
    4 u^3 + 3/2 K_D u^2 + 2 kappa u + kappa K_D / 2 = 0. At critical damping alpha = wn / 4, and
    |e| <= sqrt(32 / 27) d_max / wn^2, 8.9 % above the least that any bound can say (`peak_gain`).
    """
    kappa = K_P - K_D * K_D / 4.0
    low, high = 0.0, decay_rate(K_P, K_D)
    for _ in range(200):
        middle = (low + high) / 2.0
        u = middle - K_D / 2.0
        rises = ((4.0 * u + 1.5 * K_D) * u + 2.0 * kappa) * u + kappa * K_D / 2.0 < 0.0
        low, high = (middle, high) if rises else (low, middle)
    return (low + high) / 2.0


def lyapunov_matrix(K_P: float, K_D: float, Q: Array) -> Array:
    """Return P (2, 2) of A^T P + P A = -Q, Q (2, 2) symmetric.

    Row by row: 2 K_P P_12 = Q_11, K_D P_22 = P_12 + Q_22 / 2, P_11 = K_D P_12 + K_P P_22 - Q_12. P is
    positive definite for every positive definite Q if and only if the axis is stable (Lyapunov).

    Raises ModelError where it is not.
    """
    decay_rate(K_P, K_D)
    P_12 = Q[0, 0] / (2.0 * K_P)
    P_22 = (P_12 + Q[1, 1] / 2.0) / K_D
    P_11 = K_D * P_12 + K_P * P_22 - Q[0, 1]
    return np.array([[P_11, P_12], [P_12, P_22]])
