"""The energy function on the book's platform, and wells whose depth is known by hand."""

import numpy as np
import pytest
from scipy.optimize import minimize

from hil.app.configuration.configuration import load
from hil.app.configuration.platform import build_platform
from hil.design.stability.springs import basin, displaced, potential, rest
from hil.mathematics.linear_algebra import condition_kernel
from hil.robot.dynamics import Model
from hil.robot.kinematics import jacobian, leg_lengths
from hil.robot.kinematics_kernels import jacobian_kernel, leg_lengths_kernel

PLATFORM = build_platform(load("virtual").platform)
MODEL = Model(PLATFORM)
HOME = np.array([0.0, 0.0, 1.0]), np.eye(3)
K_P, K_V = np.full(6, 4e5), np.full(6, 4e4)
NOTHING = np.zeros(6)


def test_the_energy_falls_by_what_the_dampers_take():
    """Forces of the law, acceleration of the model, V by its definition a step later and earlier."""
    p_d, R_d = HOME
    q_d = leg_lengths(PLATFORM, p_d, R_d)

    def law(p, R, twist):
        J = jacobian(PLATFORM, p, R)
        spring = K_P * (q_d - leg_lengths(PLATFORM, p, R)) - K_V * (J @ twist)
        return spring + np.linalg.solve(J.T, MODEL.gravity(p, R))

    S = potential(MODEL, law, p_d, R_d)
    p, R = displaced(p_d, R_d, np.array([0.05, -0.03, 0.02, 0.06, -0.04, 0.05]))
    twist = np.array([0.3, -0.2, 0.1, 0.2, 0.3, -0.25])
    J = jacobian(PLATFORM, p, R)
    dq = J @ twist
    tau = law(p, R, twist)
    dtwist = MODEL.forward_dynamics(p, R, twist, tau)

    def V(t):
        at = displaced(p, R, twist * t)
        return MODEL.kinetic_energy(*at, twist + dtwist * t) + S(*at)

    h = 1e-6
    assert (V(h) - V(-h)) / (2 * h) == pytest.approx(-dq @ (K_V * dq), rel=1e-4)
    e = q_d - leg_lengths(PLATFORM, p, R)
    assert S(p, R) == pytest.approx(0.5 * e @ (K_P * e), rel=1e-9)


def test_a_pd_without_compensation_sags_to_where_its_springs_carry_the_weight():
    q_d = leg_lengths(PLATFORM, *HOME)

    def tau(p, R, twist):
        return K_P * (q_d - leg_lengths(PLATFORM, p, R)) - K_V * (jacobian(PLATFORM, p, R) @ twist)

    p, R, found = rest(MODEL, tau, *HOME)
    assert p[2] < 0.99
    np.testing.assert_allclose(
        jacobian(PLATFORM, p, R).T @ tau(p, R, NOTHING), MODEL.gravity(p, R), atol=0.05
    )
    J = jacobian(PLATFORM, p, R)
    np.testing.assert_allclose(found.damping, J.T @ np.diag(K_V) @ J, atol=1e-5)


def test_the_basin_of_a_bowl_is_known():
    """S = k |x|^2 / 2 + k_r |r|^2 / 2, the region a ball of 0.3 m of the position: the edge is anywhere on it."""

    def S(p, R):
        turn = np.arccos(np.clip((np.trace(R) - 1) / 2, -1, 1))
        return 0.5 * 1000.0 * p @ p + 0.5 * 500.0 * turn**2

    def outside(p, R):
        return None if np.linalg.norm(p) < 0.3 and np.trace(R) > -0.5 else "far"

    stiffness = np.diag([1000.0] * 3 + [500.0] * 3)
    found = basin(S, np.zeros(3), np.eye(3), stiffness, 1.0, outside)
    assert found.level_J == pytest.approx(0.5 * 1000 * 0.3**2, rel=0.02)
    assert found.level_J >= 0.5 * 1000 * 0.3**2 * (1 - 1e-6)
    assert found.reason == "far"


def condition_of(p, R):
    J = jacobian_kernel(PLATFORM.base_joints, PLATFORM.platform_joints, p, R)
    return condition_kernel(J, PLATFORM.radius)


@pytest.fixture(scope="module")
def shallow():
    """The book's platform within 0.75 to 2.2 m and a condition of 50."""
    q_d = leg_lengths(PLATFORM, *HOME)

    def S(p, R):
        e = q_d - leg_lengths(PLATFORM, p, R)
        return 0.5 * e @ (K_P * e)

    def outside(p, R):
        q = leg_lengths_kernel(PLATFORM.base_joints, PLATFORM.platform_joints, p, R)
        if q.min() < 0.77 or q.max() > 2.18:
            return "stroke"
        return None if condition_of(p, R) < 50 else "singularity"

    J = jacobian(PLATFORM, *HOME)
    return S, outside, basin(S, *HOME, J.T @ np.diag(K_P) @ J, 1.0, outside, rays=60)


def test_below_its_level_no_ray_of_another_seed_leaves_the_basin(shallow):
    S, outside, found = shallow
    for x in np.random.default_rng(7).standard_normal((60, 6)):
        for t in np.linspace(0, 1, 40):
            pose = displaced(*HOME, t * x / np.linalg.norm(x))
            if S(*pose) > found.level_J:
                break
            assert outside(*pose) is None


def test_a_search_along_the_edge_itself_finds_no_lower_level(shallow):
    """Sequential quadratic programming on condition = 50, from poses of its own: S there, at its lowest."""
    S, _, found = shallow

    def excess(x):
        return np.log(condition_of(*displaced(*HOME, x)) / 50.0)

    lowest = []
    for direction in np.random.default_rng(5).standard_normal((12, 6)):
        start = 0.4 * direction / np.linalg.norm(direction)
        result = minimize(
            lambda x: S(*displaced(*HOME, x)) / 1e4,
            start,
            method="SLSQP",
            bounds=[(-1.0, 1.0)] * 6,
            constraints=[{"type": "ineq", "fun": excess}],
            options={"maxiter": 80},
        )
        if result.success and excess(result.x) > -1e-3:
            lowest.append(1e4 * result.fun)
    assert len(lowest) > 2
    assert min(lowest) == pytest.approx(found.level_J, rel=0.01)
