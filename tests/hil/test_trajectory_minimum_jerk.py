"""Minimum jerk: against SciPy's quintic spline, the closed form for one via point, and the optimum itself."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.interpolate import make_interp_spline

from hil.config.reference import WaypointReference
from hil.config.values import Pose
from hil.trajectory.build import build_trajectory
from hil.trajectory.minimum_jerk import minimum_jerk_coefficients

T = np.array([0.0, 0.7, 1.9, 2.2, 4.0])
Y = np.random.default_rng(1).uniform(-0.2, 0.2, (5, 6))


def path(t, y, periods=1):
    points = [
        {"t_s": s, "position_m": chi[:3], "rotation_vector_deg": np.rad2deg(chi[3:])}
        for s, chi in zip(t.tolist(), y.tolist(), strict=True)
    ]
    settings = {"type": "waypoints", "interpolation": "minimum_jerk", "points": points, "periods": periods}
    return build_trajectory(WaypointReference.model_validate(settings), Pose(position_m=(0, 0, 1)), None)


def test_the_path_is_scipys_quintic_spline_at_rest_at_both_ends():
    rest = [(1, np.zeros(6)), (2, np.zeros(6))]
    spline = make_interp_spline(T, Y, k=5, bc_type=(rest, rest))
    trajectory = path(T, Y)
    for s in np.linspace(0, 4, 401):
        sample = trajectory.sample(float(s))
        np.testing.assert_allclose(sample.p, spline(s)[:3], rtol=0, atol=1e-13)
        np.testing.assert_allclose(sample.twist[:3], spline(s, 1)[:3], rtol=0, atol=1e-12)
        np.testing.assert_allclose(sample.dtwist[:3], spline(s, 2)[:3], rtol=0, atol=1e-11)


def test_two_points_give_the_rest_to_rest_quintic():
    c = minimum_jerk_coefficients(np.array([0.0, 3.0]), np.array([[1.0], [3.0]]))
    np.testing.assert_allclose(c[0, :, 0], [1, 0, 0, 20, -30, 12], rtol=0, atol=1e-14)


def test_a_via_point_half_way_is_passed_at_the_speed_of_the_whole_move():
    """Where the via point lies on the minimum-jerk path without it, it changes nothing."""
    u = 0.3
    via = 10 * u**3 - 15 * u**4 + 6 * u**5
    c = minimum_jerk_coefficients(np.array([0.0, u, 1.0]), np.array([[0.0], [via], [1.0]]))
    speed = c[1, 1, 0] / (1 - u)
    assert speed == pytest.approx(30 * u**2 * (1 - u) ** 2, rel=1e-12)
    assert 2 * c[1, 2, 0] / (1 - u) ** 2 == pytest.approx(60 * u * (1 - u) * (1 - 2 * u), rel=1e-11)


def test_no_other_path_through_the_points_has_less_jerk():
    """Moves of the path that vanish at the points and rest at the ends are orthogonal to its jerk."""
    c = minimum_jerk_coefficients(T, Y)[:, :, :1]

    def jerk(s):
        k = int(np.clip(np.searchsorted(T, s, side="right") - 1, 0, 3))
        h = T[k + 1] - T[k]
        u = (s - T[k]) / h
        return float((6 * c[k, 3, 0] + 24 * c[k, 4, 0] * u + 60 * c[k, 5, 0] * u * u) / h**3)

    cost = quad(lambda s: jerk(s) ** 2, 0, 4, points=T[1:-1], limit=200)[0]
    for power in range(3):
        # q = s^3 (4 - s)^3 (s - 0.7)(s - 1.9)(s - 2.2) s^power
        q = np.poly1d([1, 0]) ** (3 + power) * np.poly1d([-1, 4]) ** 3
        for inner in T[1:-1]:
            q = q * np.poly1d([1, -inner])
        third = q.deriv(3)
        size = quad(lambda s, d=third: d(s) ** 2, 0, 4)[0]
        inner_product = quad(lambda s, d=third: jerk(s) * d(s), 0, 4, points=T[1:-1], limit=200)[0]
        assert abs(inner_product) < 1e-9 * np.sqrt(cost * size)


def test_a_late_first_point_is_waited_for_at_rest():
    late = path(T + 1.5, Y)
    assert not late.sample(1.49).twist.any()
    np.testing.assert_array_equal(late.sample(1.49).p, Y[0, :3])
    np.testing.assert_allclose(late.sample(2.5).twist, path(T, Y).sample(1.0).twist, rtol=0, atol=1e-13)
