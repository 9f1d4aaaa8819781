"""What the model does not know, as accelerations of the axes: friction, weight off the reference, coupling."""

import numpy as np
import pytest
from scipy.signal import impulse

from hil.app.configuration.configuration import load
from hil.app.configuration.platform import build_platform
from hil.config.model import ModelSettings
from hil.control.model import build_model
from hil.robot.dynamics import Model
from hil.robot.kinematics import jacobian
from hil.stability.disturbance import Friction, Linearised, Load, Survey
from hil.stability.ultimate import _bound
from hil.trajectory.path import PoseSample

STILL = np.zeros(6)
HOME = PoseSample(np.array([0.0, 0.0, 1.0]), np.eye(3), STILL, STILL)


@pytest.fixture(scope="module")
def platform():
    return build_platform(load("virtual").platform)


def linearised(platform, axes, *, scale=1.0, coulomb_N=0.0):
    robot = Model(platform)
    believed = build_model(ModelSettings(inertia_scale=scale), platform, "none")
    friction = Friction(np.zeros(6), np.full(6, coulomb_N))
    return robot, Linearised(robot, believed, axes, Load(), friction)


def test_the_friction_of_every_leg_moves_each_in_the_worst_of_its_senses(platform):
    robot, loop = linearised(platform, "joint", coulomb_N=250.0)
    J = jacobian(platform, HOME.p, HOME.R)
    mobility = J @ np.linalg.inv(robot.mass_matrix(HOME.p, HOME.R)) @ J.T
    assert (mobility < 0.0).any(), "some legs push others the other way"
    senses = 250.0 * np.array([[1.0 if k >> i & 1 else -1.0 for i in range(6)] for k in range(64)])
    worst = (senses @ mobility.T).max(axis=0)
    np.testing.assert_allclose(loop.at(HOME, STILL, STILL).d, worst, rtol=1e-9)


def test_the_weight_is_that_of_where_the_robot_is_behind_its_reference(platform):
    """Believed masses of 0.9 leave a tenth of the weight, M^-1 G / 10 at p_d - e."""
    robot, loop = linearised(platform, "pose", scale=0.9)
    e = np.array([0.1, -0.05, 0.2, 0.0, 0.0, 0.0])
    p = HOME.p - e[:3]
    fall = np.linalg.solve(robot.mass_matrix(p, HOME.R), robot.gravity(p, HOME.R)) / 10.0
    np.testing.assert_allclose(loop.at(HOME, e, STILL).d, np.abs(fall), rtol=1e-6, atol=1e-9)


def test_what_the_inertia_is_wrong_by_feeds_the_disturbance():
    """Six axes alike, each off by s of the sum of all u: d / (1 - 6 s g), g the L1 norm from d to u."""
    t = np.linspace(0.0, 2.0, 200_001)
    _, h = impulse(([40.0, 400.0], [1.0, 40.0, 400.0]), T=t)
    g = float(np.trapezoid(np.abs(h), t))
    for s in (0.02, 0.1):
        survey = Survey(np.ones(6), 1.0, np.full((6, 6), s), 1.0)
        found = _bound(survey, np.full(6, 400.0), np.full(6, 40.0))
        assert not isinstance(found, str)
        np.testing.assert_allclose(found.d, 1.0 / (1.0 - 6.0 * s * g), rtol=1e-4)
    assert "small gain" in str(
        _bound(survey._replace(spread=np.full((6, 6), 1.0 / 6.0)), *np.full((2, 6), 40.0))
    )
