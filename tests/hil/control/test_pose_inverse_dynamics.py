"""Inverse dynamics in pose space: the engines' forces at zero error, and linear error dynamics."""

from __future__ import annotations

import numpy as np
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from hil.contracts.records import altered, asked, referred
from hil.control.pose_inverse_dynamics import PoseInverseDynamicsSettings, demanded_dtwist, pose_errors
from tests.hil.control.legs import cases, close, context_of, engines

W_N = np.array([3.0, 4.0, 5.0, 3.0, 4.0, 5.0])
ZETA = 0.7
K_P, K_D = W_N**2, 2 * ZETA * W_N
STEP, RATE = np.array([1e-2, -2e-2, 3e-2]), np.array([0.1, 0.0, -0.2])


def law_of(platform):
    settings = PoseInverseDynamicsSettings(
        law="pose_inverse_dynamics", wn_rad_s=W_N.tolist(), damping_ratio=ZETA
    )
    return settings.build(context_of(platform))


@cases(1)
def test_force_of_pose_inverse_dynamics_and_its_response_to_an_error_match_reference_engines(case):
    platform, state, sample = engines(case)
    tick = referred(platform, sample, **state, wrench=case["state"]["wrench"])
    law = law_of(platform)
    close(asked(law, tick), np.array(case["expected"]["leg_forces"]))
    ahead = altered(tick, p_d=tick["p_d"] + STEP)
    ahead["twist_d"][:3] += RATE
    more = asked(law, ahead) - asked(law, tick)
    dtwist = np.concatenate([K_P[:3] * STEP + K_D[:3] * RATE, np.zeros(3)])
    expected = np.linalg.solve(tick["J"].T, np.array(case["expected"]["M"]) @ dtwist)
    np.testing.assert_allclose(more, expected, rtol=0, atol=1e-8 * np.abs(asked(law, ahead)).max())


SPIN, TUMBLE = np.array([0.9, -1.4, 0.6]), np.array([0.5, 0.8, -0.7])


def moving_reference(t):
    """R_d = exp(t a) exp(sin(t) b): accelerated rotation about changing axes; p_d on a parabola."""
    outer = Rotation.from_rotvec(t * SPIN)
    R = (outer * Rotation.from_rotvec(np.sin(t) * TUMBLE)).as_matrix()
    w = SPIN + outer.apply(np.cos(t) * TUMBLE)
    dw = np.cross(SPIN, outer.apply(np.cos(t) * TUMBLE)) + outer.apply(-np.sin(t) * TUMBLE)
    p, v, a = (np.array(x) for x in ([t**2, -t, 1 + 0 * t], [2 * t, -1.0, 0.0], [2.0, 0.0, 0.0]))
    return p, np.ascontiguousarray(R), np.concatenate([v, w]), np.concatenate([a, dw])


def error_of(t, p, R):
    p_d, R_d, _, _ = moving_reference(t)
    return np.concatenate([p_d - p, Rotation.from_matrix(R_d @ R.T).as_rotvec()])


def turned(R, w):
    return Rotation.from_rotvec(w).as_matrix() @ R


def test_large_pose_errors_under_pose_inverse_dynamics_obey_the_linear_error_dynamics():
    """Closed form of e'' + 2 zeta wn e' + wn^2 e = 0 from 103 degrees on, with a different wn per component.

    SciPy integrates the motion from dtwist* only.
    """
    p_d, R_d, twist_d, _ = moving_reference(0.0)
    p, R = p_d - [0.3, -0.2, 0.1], turned(R_d, -np.array([1.2, -0.8, 1.1]))
    twist = twist_d + np.array([0.5, 0.2, -0.3, 1.0, -2.0, 0.7])
    h = 1e-6
    e = error_of(0.0, p, R)
    assert 1.7 < np.linalg.norm(e[3:]) < 2.0
    ahead, behind = (error_of(t, p + t * twist[:3], turned(R, t * twist[3:])) for t in (h, -h))
    de = (ahead - behind) / (2 * h)

    def slope(t, x):
        R = np.ascontiguousarray(x[3:12].reshape(3, 3))
        w = x[15:]
        dR = np.cross(w, R.T).T
        p_d, R_d, twist_d, dtwist_d = moving_reference(t)
        errors = pose_errors(x[:3].copy(), R, x[12:].copy(), p_d, R_d, twist_d)
        dtwist = demanded_dtwist(errors, K_D * errors[1] + K_P * errors[0], x[12:].copy(), twist_d, dtwist_d)
        return np.concatenate([x[12:15], dR.ravel(), dtwist])

    times = np.linspace(0.0, 2.0, 21)
    run = solve_ivp(
        slope, (0.0, 2.0), np.concatenate([p, R.ravel(), twist]), "DOP853", times, rtol=1e-11, atol=1e-12
    )
    damped = W_N * np.sqrt(1 - ZETA**2)
    for t, x in zip(times, run.y.T, strict=True):
        decay = np.exp(-ZETA * W_N * t)
        expected = decay * (e * np.cos(damped * t) + (de + ZETA * W_N * e) / damped * np.sin(damped * t))
        np.testing.assert_allclose(error_of(t, x[:3], x[3:12].reshape(3, 3)), expected, rtol=0, atol=1e-7)
