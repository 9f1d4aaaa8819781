"""PD on the pose: its wrench by scipy's rotations, taken to the legs by the engines' Jacobian."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hil.config.model import ModelSettings
from hil.contracts.records import arrived, asked, referred
from hil.control.cartesian_pd import CartesianPDSettings
from hil.control.law import LawContext
from hil.robot.geometry import Platform
from hil.trajectory.holding import HoldTrajectory
from hil.trajectory.path import PoseSample

TRUTH = json.loads((Path(__file__).parents[2] / "data" / "rigid_body_cases.json").read_text())
NONE = np.zeros(6)
K_P = np.array([1e6, 2e6, 3e6, 4e5, 5e5, 6e5])
K_V = np.array([1e5, 2e5, 3e5, 4e4, 5e4, 6e4])


def law_of(platform, model=None, **options):
    settings = CartesianPDSettings(
        law="cartesian_pd",
        kp_position_N_m=K_P[:3].tolist(),
        kv_position_N_s_m=K_V[:3].tolist(),
        kp_rotation_N_m_rad=K_P[3:].tolist(),
        kv_rotation_N_m_s_rad=K_V[3:].tolist(),
        model=model,
        **options,
    )
    return settings.build(LawContext(platform, "none", 1e-3, HoldTrajectory(np.zeros(3), np.eye(3))))


@pytest.mark.parametrize("model", [None, ModelSettings()], ids=["", "gravity"])
@pytest.mark.parametrize("case", TRUTH["cases"][::4], ids=lambda c: c["id"])
def test_the_wrench_of_the_error_is_carried_by_the_legs(case, model):
    """J^T tau = K_p [p_d - p; rotation vector of R_d R^T] + K_v (twist_d - twist) + G, turns up to 170 degrees."""
    random = np.random.default_rng(5)
    platform = Platform.from_dict(TRUTH["geometries"][case["geometry"]])
    s, e = case["state"], case["expected"]
    p, R, twist = np.array(s["p"]), np.array(s["R"]), np.array(s["v"] + s["omega"])
    state = {"q": e["lengths"], "dq": e["rates"], "p": p, "R": R, "twist": twist, "J": e["jacobian"]}
    for angle in (0.0, 1e-9, 0.3, np.radians(170)):
        axis = random.normal(size=3)
        turn = angle * axis / np.linalg.norm(axis)
        R_d = np.ascontiguousarray((Rotation.from_rotvec(turn) * Rotation.from_matrix(R)).as_matrix())
        p_d, twist_d = p + random.normal(0, 0.1, 3), random.normal(0, 1, 6)
        tau = asked(law_of(platform, model), referred(platform, PoseSample(p_d, R_d, twist_d, NONE), **state))
        wrench = K_P * np.concatenate([p_d - p, turn]) + K_V * (twist_d - twist)
        if model is not None:
            wrench = wrench + e["G"]
        np.testing.assert_allclose(
            np.transpose(e["jacobian"]) @ tau, wrench, rtol=0, atol=1e-9 * np.abs(wrench).max()
        )


@pytest.mark.parametrize("case", TRUTH["cases"][::8], ids=lambda c: c["id"])
def test_the_difference_of_two_rotation_vectors_is_there_for_comparison(case):
    platform = Platform.from_dict(TRUTH["geometries"][case["geometry"]])
    s, e = case["state"], case["expected"]
    p, R = np.array(s["p"]), np.array(s["R"])
    state = {"q": e["lengths"], "p": p, "R": R, "J": e["jacobian"]}
    phi_d = np.array([0.3, -0.2, 0.4])
    R_d = np.ascontiguousarray(Rotation.from_rotvec(phi_d).as_matrix())
    tick = referred(platform, PoseSample(p, R_d, NONE, NONE), **state)
    tau = asked(law_of(platform, rotation_error="vector_difference"), tick)
    wrench = K_P * np.concatenate([np.zeros(3), phi_d - Rotation.from_matrix(R).as_rotvec()])
    np.testing.assert_allclose(
        np.transpose(e["jacobian"]) @ tau, wrench, rtol=0, atol=1e-9 * np.abs(wrench).max()
    )


def test_a_singular_jacobian_gives_no_number():
    platform = Platform.from_dict(TRUTH["geometries"][TRUTH["cases"][0]["geometry"]])
    tick = arrived(platform, PoseSample(np.array([0.0, 0.0, 1.0]), np.eye(3), NONE, NONE), J=0.0)
    assert np.isnan(asked(law_of(platform), tick)).all()
