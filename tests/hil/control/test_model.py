"""From the section `model` to the model: every key arrives, in SI."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hil.config.model import ModelSettings
from hil.config.values import Pose
from hil.control.model import build_model
from hil.robot.geometry import Platform

TRUTH = json.loads((Path(__file__).parents[2] / "data" / "rigid_body_cases.json").read_text())
CASE = next(c for c in TRUTH["cases"] if np.abs(c["state"]["omega"]).min() > 0)
PLATFORM = Platform.from_dict(TRUTH["geometries"][CASE["geometry"]])
P, R = np.array(CASE["state"]["p"]), np.array(CASE["state"]["R"])
J, M, G = (np.array(CASE["expected"][key]) for key in ("jacobian", "M", "G"))


def test_masses_are_scaled_and_the_drives_added_along_the_legs():
    model = build_model(ModelSettings(reflected_mass_kg=[1, 2, 3, 4, 5, 6]), PLATFORM, "none")
    np.testing.assert_allclose(
        model.mass_matrix(P, R), M + J.T @ np.diag([1, 2, 3, 4, 5, 6]) @ J, atol=1e-9 * np.abs(M).max()
    )
    light = build_model(ModelSettings(inertia_scale=0.9), PLATFORM, "none")
    np.testing.assert_allclose(light.mass_matrix(P, R)[:3, :3], 0.9 * M[:3, :3], atol=1e-9 * np.abs(M).max())


def test_frictions_and_the_speed_of_sliding_arrive():
    settings = ModelSettings(
        viscous_friction_N_s_m=[10, 20, 30, 40, 50, 60], coulomb_friction_N=200, sliding_speed_m_s=0.01
    )
    dq = np.array([0.005, -0.005, 0.01, -0.02, 0.0, 1.0])
    friction = build_model(settings, PLATFORM, "none").friction(dq)
    assert friction == pytest.approx([100.05, -100.1, 200.3, -200.8, 0.0, 260.0])


def test_a_pose_in_degrees_is_where_the_model_is_frozen():
    """Elsewhere and in any motion it gives the engines' forces of that pose."""
    pose = Pose(
        position_m=tuple(P), rotation_vector_deg=tuple(Rotation.from_matrix(R).as_rotvec(degrees=True))
    )
    model = build_model(ModelSettings(variant="constant", frozen_at=pose), PLATFORM, "none")
    a = np.array([1.0, -2.0, 0.5, 0.3, -0.2, 0.1])
    tau = model.inverse_dynamics(P + 0.05, np.eye(3), np.ones(6), a)
    expected = np.linalg.solve(J.T, M @ a + G)
    np.testing.assert_allclose(tau, expected, rtol=0, atol=1e-9 * np.abs(expected).max())
