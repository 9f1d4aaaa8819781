"""How far a bounded disturbance can bring the error: what no bound undercuts, and what norms make of it.

Three bounds on an output y = c_e e + c_de de under |d| <= d_max, from x(0) = 0 at all times and from
anywhere in the end, the tightest first:

- ``peak_gain``: the integral of |h(t)|, h the impulse response from d to y. Some disturbance attains it (the
  one that changes its sign with h), so that no bound is smaller.
- ``error_dynamics.Certificate.error_gain``: the reachable ellipsoid. It comes with a Lyapunov
  function; at critical damping it is 8.9 % above.
- ``norm_bound``: the textbook's, by the eigenvalues of P. At critical damping and Q = I it is 404 times too
  large for wn = 5 rad/s and 81 000 times for 20: it takes m and m/s for equals.
"""

from math import atan2, cos, exp, expm1, log, pi, sin, sqrt

import numpy as np

from drivers.arrays import Array
from hil.design.stability.error_dynamics import decay_rate, lyapunov_matrix


def peak_gain(K_P: float, K_D: float, c_e: float = 1.0, c_de: float = 0.0) -> float:
    """Return the peak-to-peak gain from d to c_e e + c_de de, the L1 norm of its impulse response.

    For e alone, of damping ratio zeta, it is 1 / K_P from zeta = 1 on, because e does not overshoot, and
    coth(pi zeta / (2 sqrt(1 - zeta^2))) / K_P below. In general the response is integrated in closed form
    from zero to zero; of complex poles the zeros are half a period apart and the areas a geometric series.

    Raises ModelError where the axis is not stable.
    """
    decay_rate(K_P, K_D)
    sigma, square = K_D / 2.0, K_P - K_D * K_D / 4.0

    def step(t: float) -> float:
        """Return the answer of the output to a unit step of d."""
        cosine, sine = _modes(sigma, square, t)
        return c_e * (1.0 - cosine - sigma * sine) / K_P + c_de * sine

    final = c_e / K_P
    if square > 1e-12 * K_P:
        w = sqrt(square)
        first = atan2(c_de * w, c_de * sigma - c_e) / w  # tan(w t) = c_de w / (c_de sigma - c_e)
        first += pi / w if first <= 0.0 else 0.0
        shrink = exp(-sigma * pi / w)
        return abs(step(first)) + abs(step(first + pi / w) - step(first)) / (1.0 - shrink)
    turn = _only_zero(sigma, sqrt(max(-square, 0.0)), c_e, c_de)
    return abs(final) if turn is None else abs(step(turn)) + abs(final - step(turn))


def norm_bound(K_P: float, K_D: float, Q: Array | None = None) -> float:
    """Return the textbook's ultimate bound on |x|, x = [e; de], per unit of d, with A^T P + P A = -Q.

    2 |P B| / lambda_min(Q) sqrt(lambda_max(P) / lambda_min(P)) with |P B| <= lambda_max(P), Q = I by default
    (H. K. Khalil, Nonlinear Systems, 3rd ed., 2002, lemma 9.2 with V = x^T P x).
    """
    Q = np.eye(2) if Q is None else Q
    least, largest = np.linalg.eigvalsh(lyapunov_matrix(K_P, K_D, Q))
    return float(2.0 * largest / np.linalg.eigvalsh(Q)[0] * sqrt(largest / least))


def _modes(sigma: float, square: float, t: float) -> tuple[float, float]:
    """Return exp(-sigma t) cos(w t) and exp(-sigma t) sin(w t) / w, w^2 = square of any sign."""
    if square > 0.0:
        w = sqrt(square)
        return exp(-sigma * t) * cos(w * t), exp(-sigma * t) * sin(w * t) / w
    r = sqrt(-square)
    slow, fast = exp((r - sigma) * t), exp(-(r + sigma) * t)
    return (slow + fast) / 2.0, (-expm1(-2.0 * r * t) * slow / (2.0 * r) if r > 0.0 else t * slow)


def _only_zero(sigma: float, r: float, c_e: float, c_de: float) -> float | None:
    """Return the t > 0 at which the impulse response of real poles -(sigma -+ r) changes its sign, if any.

    (c_e - c_de (sigma - r)) exp(r t) = (c_e - c_de (sigma + r)) exp(-r t).
    """
    slow, fast = c_e - c_de * (sigma - r), c_e - c_de * (sigma + r)
    if r <= 1e-9 * sigma:
        t = c_de / (c_de * sigma - c_e) if c_de * sigma != c_e else 0.0
    else:
        t = log(fast / slow) / (2.0 * r) if fast * slow > 0.0 else 0.0
    return t if t > 0.0 else None
