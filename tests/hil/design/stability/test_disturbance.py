"""Model errors as accelerations of the axes: friction, inertia, and delayed forces."""

import numpy as np
import pytest
from scipy.signal import impulse

from hil.app.configuration.configuration import load
from hil.app.configuration.platform import build_platform
from hil.config.model import ModelSettings
from hil.control.model import build_model
from hil.design.stability.delay_effect import DelayEffect
from hil.design.stability.disturbance import Friction, Linearised, Load, Survey
from hil.design.stability.ultimate import Extra, _bound
from hil.robot.dynamics import Model
from hil.robot.kinematics import jacobian
from hil.trajectory.path import PoseSample

NOT_LOST = np.zeros((6, 6))
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


def test_friction_disturbance_takes_the_worst_sign_of_each_leg(platform):
    robot, loop = linearised(platform, "joint", coulomb_N=250.0)
    J = jacobian(platform, HOME.p, HOME.R)
    mobility = J @ np.linalg.inv(robot.mass_matrix(HOME.p, HOME.R)) @ J.T
    assert (mobility < 0.0).any(), "some legs push others the other way"
    senses = 250.0 * np.array([[1.0 if k >> i & 1 else -1.0 for i in range(6)] for k in range(64)])
    worst = (senses @ mobility.T).max(axis=0)
    np.testing.assert_allclose(loop.at([HOME]).d[0], worst, rtol=1e-9)


def test_an_inertia_error_amplifies_the_disturbance():
    """Six equal axes, each disturbed by s times the sum of all u: d / (1 - 6 s g), g the L1 norm from d to u."""
    t = np.linspace(0.0, 2.0, 200_001)
    _, h = impulse(([40.0, 400.0], [1.0, 40.0, 400.0]), T=t)
    g = float(np.trapezoid(np.abs(h), t))
    gains = np.array([np.ones(6), np.ones(6), np.full(6, g)])
    none = Extra(STILL, STILL, 0.0, STILL, STILL, STILL, STILL, NOT_LOST)

    def bound(spread):
        survey = Survey(np.ones(6), 1.0, np.full((6, 6), spread), np.zeros((6, 6)), np.zeros((6, 6)), 1.0)
        return _bound(survey, gains, DelayEffect.none(), none)

    for s in (0.02, 0.1):
        found = bound(s)
        assert not isinstance(found, str)
        np.testing.assert_allclose(found.d, 1.0 / (1.0 - 6.0 * s * g), rtol=1e-4)
    assert "small gain" in str(bound(1.0 / 6.0))


def test_delayed_forces_add_a_disturbance_by_position_and_rate_change():
    """One axis by hand: d' = 1 + T (S_e (r + g_de d') + S_v (u + g_u d' + d')) + alpha (u + g_u d')."""
    g_e, g_de, g_u, T, S_e, S_v, alpha = 2.0, 3.0, 1.5, 0.01, 4.0, 5.0, 0.1
    survey = Survey(np.ones(6), 1.0, np.zeros((6, 6)), S_e * np.eye(6), S_v * np.eye(6), 1.0)
    u, r = 0.7, 0.2
    late = DelayEffect(np.full(6, 0.01), np.full(6, r), np.full(6, u), T)
    gains = np.outer([g_e, g_de, g_u], np.ones(6))
    found = _bound(
        survey, gains, late, Extra(STILL, STILL, alpha, np.full(6, 1e-3), STILL, STILL, STILL, NOT_LOST)
    )
    assert not isinstance(found, str)
    known = 1.0 + T * (S_e * r + S_v * u) + alpha * u
    d = known / (1.0 - T * (S_e * g_de + S_v * (g_u + 1.0)) - alpha * g_u)
    np.testing.assert_allclose(found.d, d, rtol=1e-6)
    np.testing.assert_allclose(found.error, 0.01 + g_e * d + 1e-3, rtol=1e-6)
