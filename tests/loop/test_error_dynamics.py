"""Decay of an initial error: each law's own linear equation, solved here in closed form or by scipy.

The plant starts 20 mm and 5 degrees (feed-forward with PD: 1 mm and 0.25 degrees) away from the reference, on
the ideal path. Without a force ramp the law acts at once, so no approach hides the error. The remaining
difference comes from the zero-order hold: it halves with the period.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

from hil.app.configuration.configuration import load
from hil.app.configuration.platform import build_platform
from hil.mathematics.rotations import rotation_from_vector
from hil.robot.dynamics import Model
from hil.robot.kinematics import jacobian, leg_lengths
from tests.loop.bench import changed, run

HOME_m = np.array([0.0, 0.0, 1.0])
W_N = 20.0
DIRECTIONS = {
    "along x, about z": ([1.0, 0.0, 0.0], [0.0, 0.0, 1.0]),
    "askew": ([0.6, -0.48, 0.64], [-0.48, 0.64, 0.6]),
}
directions = pytest.mark.parametrize("direction", DIRECTIONS)
PLATFORM = build_platform(load("ideal").platform)


def track(law, direction, *, metres=0.02, degrees=5.0, rate_Hz=1000, **sections):
    """Rows of the tracking, and the pose p (3,), R (3, 3) at which the plant started."""
    along, about = (np.array(v) for v in DIRECTIONS[direction])
    p, vector_deg = HOME_m + metres * along, degrees * about
    start = {"initial_position_m": p, "initial_rotation_vector_deg": vector_deg}
    c = changed("ideal", controller=law, plant=start, loop={"rate_Hz": rate_Hz}, **sections)
    ran = run(c, stop_s=0.8)
    assert ran.ending.success, ran.ending
    assert not any(ran.summary["limited_ticks"].values())
    assert len(ran.tracking) > 0.5 * rate_Hz, "1 / 2000 of the error is left by then"
    return ran.tracking, p, rotation_from_vector(np.deg2rad(vector_deg))


def leg_errors(p, R):
    return leg_lengths(PLATFORM, HOME_m, np.eye(3)) - leg_lengths(PLATFORM, p, R)


def critically_damped(e0, t):
    """e'' + 2 wn e' + wn^2 e = 0 from e0 at rest: e0 (1 + wn t) exp(-wn t)."""
    return e0 * ((1.0 + W_N * t) * np.exp(-W_N * t))[:, np.newaxis]


def deviation(found, expected):
    """Largest difference over the largest initial error."""
    return float(np.abs(found - expected).max() / np.abs(expected[0]).max())


INVERSE_DYNAMICS = {"law": "inverse_dynamics", "wn_rad_s": W_N}


@directions
def test_exact_inverse_dynamics_give_each_leg_an_uncoupled_linear_error_equation(direction):
    rows, p, R = track(INVERSE_DYNAMICS, direction)
    expected = critically_damped(leg_errors(p, R), rows["reference_time_s"])
    assert 0.04 < np.abs(expected[0]).max() < 0.11
    assert deviation(rows["q_d"] - rows["q"], expected) < 0.005


@directions
def test_feed_forward_with_pd_couples_the_legs_through_the_inertia(direction):
    """M e'' + Kv e' + Kp e = 0 with the leg-space inertia M at home, by the matrix exponential."""
    kp, kv = 2.0e6, 5.0e4
    law = {"law": "feedforward_pd", "kp_N_m": kp, "kv_N_s_m": kv}
    hold = {"type": "hold", "pose": {"position_m": HOME_m}, "duration_s": 0.6}
    rows, p, R = track(law, direction, metres=1e-3, degrees=0.25, reference=hold)
    inverse = np.linalg.inv(jacobian(PLATFORM, HOME_m, np.eye(3)))
    M = inverse.T @ Model(PLATFORM).mass_matrix(HOME_m, np.eye(3)) @ inverse
    e, e0 = rows["q_d"] - rows["q"], leg_errors(p, R)
    assert deviation(e, answer(M, kp, kv, e0, len(e))) < 0.02
    assert deviation(e, answer(np.diag(np.diag(M)), kp, kv, e0, len(e))) > 0.05, "the coupling is seen"


def answer(M, kp, kv, e0, ticks):
    """M e'' + kv e' + kp e = 0 from e0 at rest, at every millisecond."""
    inverse = np.linalg.inv(M)
    A = np.block([[np.zeros((6, 6)), np.eye(6)], [-kp * inverse, -kv * inverse]])
    step, x, found = expm(1e-3 * A), np.concatenate([e0, np.zeros(6)]), []
    for _ in range(ticks):
        found.append(x[:6])
        x = step @ x
    return np.array(found)
