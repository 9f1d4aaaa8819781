"""The Reference in leg lengths, against the book's platform and finite differences."""

import json
from pathlib import Path

import numpy as np

from hil.config.reference import WaypointReference
from hil.config.values import Pose
from hil.robot.geometry import Platform
from hil.trajectory.build import build_trajectory
from tests.records import referred

BOOK = json.loads((Path(__file__).parent.parent / "data" / "book_platform.json").read_text())
PLATFORM = Platform.from_dict(BOOK["geometry"])
TRAJECTORY = build_trajectory(
    WaypointReference.model_validate(
        {
            "type": "waypoints",
            "interpolation": "cubic",
            "points": [
                {"t_s": k["t"], "position_m": k["p"], "rotation_vector_deg": k["rotvec_deg"]}
                for k in BOOK["trajectory"]["knots"]
            ],
        }
    ),
    Pose(position_m=(0, 0, 1)),
    None,
)


def test_lengths_and_rates_are_the_books():
    for state in BOOK["states"]:
        reference = referred(PLATFORM, TRAJECTORY.sample(state["t"]))
        np.testing.assert_allclose(reference["q_d"], state["length"], rtol=0, atol=1e-9)
        np.testing.assert_allclose(reference["dq_d"], state["rate"], rtol=0, atol=1e-9)


def test_leg_acceleration_is_the_derivative_of_the_rate():
    h = 1e-3
    for t in np.linspace(0.05, 0.95, 19):
        ddq = referred(PLATFORM, TRAJECTORY.sample(t))["ddq_d"]
        rate = {k: referred(PLATFORM, TRAJECTORY.sample(t + k * h / 2))["dq_d"] for k in (-2, -1, 1, 2)}
        expected = (4 * (rate[1] - rate[-1]) / h - (rate[2] - rate[-2]) / (2 * h)) / 3
        np.testing.assert_allclose(ddq, expected, rtol=0, atol=1e-8)


def test_the_pose_passes_through_untouched():
    sample = TRAJECTORY.sample(0.3)
    reference = referred(PLATFORM, sample)
    for name, value in sample._asdict().items():
        assert reference[name + "_d"].tobytes() == value.tobytes()
