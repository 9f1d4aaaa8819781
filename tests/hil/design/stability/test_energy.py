"""The energy function on the book's platform, and the pose at which springs carry the weight."""

import numpy as np
import pytest

from hil.app.configuration.configuration import load
from hil.app.configuration.platform import build_platform
from hil.design.stability.springs import displaced, rest
from hil.robot.dynamics import Model
from hil.robot.kinematics import jacobian, leg_lengths

PLATFORM = build_platform(load("virtual").platform)
MODEL = Model(PLATFORM)
HOME = np.array([0.0, 0.0, 1.0]), np.eye(3)
K_P, K_V = np.full(6, 4e5), np.full(6, 4e4)
NOTHING = np.zeros(6)


def test_energy_decreases_by_the_power_of_the_damping():
    """Forces of the law, acceleration of the model, and V by its definition one step later and earlier."""
    p_d, R_d = HOME
    q_d = leg_lengths(PLATFORM, p_d, R_d)

    def law(p, R, twist):
        J = jacobian(PLATFORM, p, R)
        spring = K_P * (q_d - leg_lengths(PLATFORM, p, R)) - K_V * (J @ twist)
        return spring + np.linalg.solve(J.T, MODEL.gravity(p, R))

    def S(p, R):
        e = q_d - leg_lengths(PLATFORM, p, R)
        return 0.5 * e @ (K_P * e)

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


def test_a_pd_without_compensation_sags_until_its_springs_carry_the_weight():
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
