"""Ten parameters of a body, against a cloud of points by Newton's law, and against the loop's model."""

import numpy as np
import pytest

from hil.lab.identify.estimators.rigid_body import (
    body_of,
    from_pseudo_inertia,
    parameters_of,
    pseudo_inertia,
    regressor,
)
from hil.mathematics.rotations import rotation_from_vector
from hil.robot.dynamics import Model
from hil.robot.geometry import Body
from hil.robot.kinematics import jacobian
from tests.hil.test_dynamics import CASES, PLATFORMS, state_of

GRAVITY = np.array([0.3, -0.2, -9.81])
RNG = np.random.default_rng(3)
MASSES, POINTS = RNG.uniform(1.0, 20.0, 7), RNG.normal(0.15, 0.4, (7, 3))


def cloud():
    """Theta of the points by its definition."""
    I = sum(m * (x @ x * np.eye(3) - np.outer(x, x)) for m, x in zip(MASSES, POINTS, strict=True))
    return np.array([
        MASSES.sum(), *(MASSES @ POINTS), I[0, 0], I[1, 1], I[2, 2], I[0, 1], I[0, 2], I[1, 2]
    ])  # fmt: skip


def pose(t):
    turn = rotation_from_vector(np.array([0.4 * np.sin(2.1 * t), 0.3 * np.cos(1.7 * t), 0.5 * t]))
    return np.array([0.2 * np.sin(3.0 * t), 0.1 * t * t, 1.0 + 0.3 * np.cos(2.0 * t)]), turn


def places(t):
    p, R = pose(t)
    return p + POINTS @ R.T


def second_difference(f, t, h=1e-3):
    return (-f(t + 2 * h) + 16 * f(t + h) - 30 * f(t) + 16 * f(t - h) - f(t - 2 * h)) / (12 * h * h)


def difference(f, t, h=1e-3):
    return (-f(t + 2 * h) + 8 * f(t + h) - 8 * f(t - h) + f(t - 2 * h)) / (12 * h)


def omega(t):
    W = difference(lambda s: pose(s)[1], t) @ pose(t)[1].T
    return np.array([W[2, 1], W[0, 2], W[1, 0]])


@pytest.mark.parametrize("t", [0.1, 0.7, 1.9])
def test_regressor_force_is_the_sum_of_newtons_law_over_a_cloud_of_points(t):
    (p, R), a = pose(t), second_difference(places, t)
    each = MASSES[:, None] * (a - GRAVITY)
    expected = np.concatenate([each.sum(axis=0), np.cross(places(t) - p, each).sum(axis=0)])
    twist = np.concatenate([difference(lambda s: pose(s)[0], t), omega(t)])
    dtwist = np.concatenate([second_difference(lambda s: pose(s)[0], t), difference(omega, t)])
    Y = regressor(R[None], twist[None], dtwist[None], GRAVITY)[0]
    np.testing.assert_allclose(Y @ cloud(), expected, rtol=0, atol=1e-6 * np.abs(expected).max())


@pytest.mark.parametrize("case", CASES[:12])
def test_regressor_times_parameter_difference_is_the_force_difference_of_two_platforms(case):
    """The legs and their inertia cancel: the model is linear in the platform's parameters."""
    p, R, twist, dtwist, wrench, _ = state_of(case)
    platform = PLATFORMS[case["geometry"]]
    other = Body(1.7 * platform.platform.mass, np.array([0.1, -0.2, 0.15]), np.diag([90.0, 100.0, 120.0]))
    changed = {**platform.to_dict(), "platform": {k: np.asarray(v).tolist() for k, v in vars(other).items()}}
    laden = type(platform).from_dict(changed)
    more, less = (Model(m).inverse_dynamics(p, R, twist, dtwist, wrench) for m in (laden, platform))
    Y = regressor(R[None], twist[None], dtwist[None], platform.gravity)[0]
    theta = parameters_of(other) - parameters_of(platform.platform)
    found = np.linalg.solve(jacobian(platform, p, R).T, Y @ theta)
    np.testing.assert_allclose(found, more - less, rtol=0, atol=1e-9 * np.abs(more).max())


def test_pseudo_inertia_is_the_second_moment_of_the_points():
    x = np.column_stack([POINTS, np.ones(len(POINTS))])
    expected = (MASSES[:, None] * x).T @ x
    np.testing.assert_allclose(pseudo_inertia(cloud()), expected, rtol=0, atol=1e-12)
    np.testing.assert_allclose(from_pseudo_inertia(expected), cloud(), rtol=0, atol=1e-12)


def test_body_and_its_ten_parameters_convert_into_each_other():
    body = body_of(cloud())
    com = MASSES @ POINTS / MASSES.sum()
    away = POINTS - com
    I = sum(m * (x @ x * np.eye(3) - np.outer(x, x)) for m, x in zip(MASSES, away, strict=True))
    np.testing.assert_allclose(body.com, com, rtol=0, atol=1e-14)
    np.testing.assert_allclose(body.inertia, I, rtol=0, atol=1e-12)
    np.testing.assert_allclose(parameters_of(body), cloud(), rtol=0, atol=1e-12)
