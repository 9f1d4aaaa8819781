"""Peak gains against closed forms and brute integration; how far each bound is above what a disturbance does."""

import numpy as np
import pytest
from scipy.linalg import expm

from hil.design.stability.error_dynamics import certificate
from hil.design.stability.reachable import norm_bound, peak_gain

AXES = [(400.0, 40.0), (400.0, 8.0), (400.0, 100.0), (3.0, 0.4), (8464.0, 184.0), (360.0, 36.0)]
OUTPUTS = [(1.0, 0.0), (0.0, 1.0), (92.0, 1.0), (400.0, 40.0), (-5.0, 1.0), (20.0, 1.0)]


@pytest.mark.parametrize(("K_P", "K_D"), AXES)
@pytest.mark.parametrize(("c_e", "c_de"), OUTPUTS)
def test_the_peak_gain_is_the_area_under_the_impulse_response(K_P, K_D, c_e, c_de):
    doublings = 14
    period = 25 / -np.roots([1, K_D, K_P]).real.max() / 2**doublings
    A = np.array([[0.0, 1.0], [-K_P, -K_D]])
    x = np.array([[0.0], [1.0]])
    Phi = expm(A * period)
    for _ in range(doublings):
        x, Phi = np.hstack([x, Phi @ x]), Phi @ Phi
    h = np.array([c_e, c_de]) @ x
    assert peak_gain(K_P, K_D, c_e, c_de) == pytest.approx(np.trapezoid(np.abs(h)) * period, rel=5e-4)


def test_without_overshoot_it_is_the_compliance():
    assert peak_gain(20.0**2, 2 * 20.0) == pytest.approx(1 / 20.0**2, rel=1e-12)
    assert peak_gain(400.0, 90.0) == pytest.approx(1 / 400.0, rel=1e-12)


@pytest.mark.parametrize("zeta", [0.1, 0.5, 0.9])
def test_with_overshoot_it_is_the_compliance_times_a_hyperbolic_cotangent(zeta):
    expected = 1 / np.tanh(np.pi * zeta / 2 / np.sqrt(1 - zeta**2)) / 400.0
    assert peak_gain(400.0, 2 * zeta * 20.0) == pytest.approx(expected, rel=1e-12)


def test_the_rate_of_critical_damping_by_hand():
    """The largest e of an impulse, twice: 2 / (e wn)."""
    assert peak_gain(400.0, 40.0, 0.0, 1.0) == pytest.approx(2 / np.e / 20.0, rel=1e-9)


def test_the_demanded_acceleration_of_critical_damping_by_hand():
    """K_P e + K_D de overshoots once, at 2 / wn, by exp(-2)."""
    assert peak_gain(400.0, 40.0, 400.0, 40.0) == pytest.approx(1 + 2 * np.exp(-2.0), rel=1e-9)


@pytest.mark.parametrize(("K_P", "K_D"), AXES)
def test_the_ellipsoid_lies_between_what_is_attained_and_twice_that(K_P, K_D):
    assert peak_gain(K_P, K_D) <= certificate(K_P, K_D).error_gain()[0] <= 2.0 * peak_gain(K_P, K_D)
    assert peak_gain(K_P, K_D, 0, 1) <= certificate(K_P, K_D).rate_gain()[0]


def test_the_textbooks_norm_bound_is_hundreds_to_tens_of_thousands_of_times_too_loose(capsys):
    """By hand for wn = 5, Q = I: P = [1.5 0.02; 0.02 0.052], of which only the eigenvalues count."""
    with capsys.disabled():
        print(
            "\nultimate bound of |e| over the least possible, critical damping\n   wn  ellipsoid   norms, Q = I"
        )
        for w_n in (5.0, 10.0, 20.0):
            least = peak_gain(w_n**2, 2 * w_n)
            ellipsoid = certificate(w_n**2, 2 * w_n).error_gain()[0] / least
            norms = norm_bound(w_n**2, 2 * w_n) / least
            print(f"  {w_n:3.0f} {ellipsoid:10.3f} {norms:14.0f}")
            assert ellipsoid == pytest.approx(np.sqrt(32 / 27), rel=1e-9)
            assert norms > 200.0
    least, largest = np.linalg.eigvalsh([[1.5, 0.02], [0.02, 0.052]])
    assert norm_bound(25.0, 10.0) == pytest.approx(2 * largest * np.sqrt(largest / least), rel=1e-9)


def test_a_disturbance_that_turns_with_the_impulse_response_attains_the_peak_gain():
    """Bang-bang: d(t) = sgn h(T - t), here of a lightly damped axis."""
    K_P, K_D, end, n = 400.0, 8.0, 2.5, 5000
    t = (np.arange(n) + 0.5) * end / n
    w = np.sqrt(K_P - K_D**2 / 4)
    d = np.sign(np.sin(w * (end - t)))
    step = expm(np.array([[0, 1, 0], [-K_P, -K_D, 1], [0, 0, 0]]) * end / n)
    x = np.zeros(2)
    for k in range(n):
        x = step[:2, :2] @ x + step[:2, 2] * d[k]
    assert x[0] == pytest.approx(peak_gain(K_P, K_D), rel=1e-3)
    assert x[0] <= certificate(K_P, K_D).error_gain()[0]
