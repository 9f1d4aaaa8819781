"""Cross-over and phase margin against the characteristic equation of the loop with a delay."""

import cmath
from math import inf, radians, sqrt

import pytest

from hil.control.margin import cross_over, phase_margin_deg

GAINS = [(20.0**2, 40.0), (92.0**2, 184.0), (8000.0, 210.0), (100.0, 300.0), (2500.0, 10.0)]


@pytest.mark.parametrize(("K_P", "K_D"), GAINS)
def test_a_delay_that_eats_the_margin_puts_a_root_on_the_imaginary_axis(K_P, K_D):
    """s^2 + (K_D s + K_P) exp(-s T) = 0 at s = j w_c: more delay than that and the loop is unstable."""
    w = cross_over(K_P, K_D)
    T = radians(phase_margin_deg(K_P, K_D)) / w
    assert phase_margin_deg(K_P, K_D, T) == pytest.approx(0.0, abs=1e-9)
    s = 1j * w
    assert abs(s * s + (K_D * s + K_P) * cmath.exp(-s * T)) < 1e-9 * w * w


def test_critical_damping_crosses_over_at_2_06_wn_and_leaves_76_degrees():
    assert cross_over(400.0, 40.0) == pytest.approx(20.0 * sqrt(2.0 + sqrt(5.0)), rel=1e-12)
    assert phase_margin_deg(400.0, 40.0) == pytest.approx(76.345, abs=1e-3)


def test_thirty_degrees_are_left_at_wn_T_of_0_39_and_37_at_a_third():
    assert phase_margin_deg(1.0, 2.0, 0.393) == pytest.approx(30.0, abs=0.1)
    assert phase_margin_deg(1.0, 2.0, 1 / 3) == pytest.approx(37.0, abs=0.1)


def test_a_law_that_switches_has_no_margin_against_any_delay():
    assert cross_over(inf, inf) == inf
    assert phase_margin_deg(inf, inf, 1e-9) == -inf
    assert phase_margin_deg(inf, inf) == 90.0
