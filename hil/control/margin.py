"""Phase margin of a law with error dynamics e'' + K_D e' + K_P e = d under a delay.

Opened at the leg's acceleration, the loop of such a law is L(s) = (K_D s + K_P) / s^2. With critical damping
its crossover frequency is w_c = 2.058 wn, K_P = wn^2, and its phase margin 76.35 deg. A delay T (bus, hold,
force loop) reduces the margin by w_c T. For a margin of 30 deg, wn T = 0.39 limits the gains on a bus.
"""

from math import atan, degrees, inf, isinf, sqrt


def cross_over(K_P: float, K_D: float) -> float:
    """Crossover frequency w_c, rad/s, where (K_D s + K_P) / s^2 has gain 1; inf for infinite gains."""
    if isinf(K_D):
        return inf
    return sqrt((K_D**2 + sqrt(K_D**4 + 4.0 * K_P**2)) / 2.0)


def phase_margin_deg(K_P: float, K_D: float, delay_s: float = 0.0) -> float:
    """Phase margin 180 deg + arg L(j w_c) exp(-j w_c T), T = delay_s; -inf for infinite gains and a delay."""
    if isinf(K_D):
        return -inf if delay_s > 0.0 else 90.0
    w_c = cross_over(K_P, K_D)
    return degrees(atan(K_D * w_c / K_P) - w_c * delay_s)
