"""A robot on a wall or at the ceiling moves and carries as the same robot with all its frames turned."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import hil
from hil.app.configuration.configuration import load

SOON: dict[str, Any] = {
    "engage": {"force_ramp_s": 0.05, "brake_release_s": 0.1, "blend_s": 0.1, "stop_s": 0.3},
}
MOUNTINGS = {
    "ceiling": Rotation.from_euler("x", 180, degrees=True),
    "wall": Rotation.from_euler("y", 90, degrees=True),
    "oblique": Rotation.from_rotvec([0.6, -0.7, 0.5]),
}


def run(folder, Q: Rotation) -> Any:
    """Log of a run of the desktop robot with base, platform and gravity turned by Q; gravity is -z before."""

    def turned(rows):
        return np.round(Q.apply(rows), 15).tolist()

    robot = load("desktop").platform
    points = [(0.0, (0, 0, 0.2833), (0, 0, 0)), (0.3, (0.01, -0.005, 0.29), (3, -2, 4))]
    body = robot.platform
    I = Q.as_matrix() @ np.array(body.inertia_kg_m2) @ Q.as_matrix().T
    platform = {
        "base_joints_m": turned(robot.base_joints_m),
        "platform_joints_m": turned(robot.platform_joints_m),
        "platform": {"com_m": turned(body.com_m), "inertia_kg_m2": ((I + I.T) / 2).tolist()},
        "gravity_m_s2": turned(robot.gravity_m_s2),
        "home": {"position_m": turned(robot.home.position_m)},
    }
    reference = {
        "type": "waypoints",
        "points": [
            {"t_s": t, "position_m": turned(p), "rotation_vector_deg": turned(r)} for t, p, r in points
        ],
    }
    path = folder / "run.mcap"
    hil.sim("desktop", log=path, plant_log=False, platform=platform, reference=reference, **SOON)
    return hil.Log(path)


@pytest.fixture(scope="module")
def standing(tmp_path_factory):
    return run(tmp_path_factory.mktemp("standing"), Rotation.identity())


@pytest.mark.parametrize("mounting", MOUNTINGS)
def test_robot_on_wall_or_ceiling_behaves_as_the_standing_one_with_frames_turned(
    mounting, standing, tmp_path
):
    Q = MOUNTINGS[mounting]
    here, there = (log.frame("tau", "q", "p", "mode") for log in (standing, run(tmp_path, Q)))
    assert here["mode"].tolist() == there["mode"].tolist()
    assert (here["mode"] == "TRACKING").sum() > 100
    a, b = (frame.drop(columns="mode").to_numpy(float) for frame in (here, there))
    b[:, 12:] = Q.inv().apply(b[:, 12:])
    np.testing.assert_allclose(b, a, rtol=1e-6, atol=1e-6)
