"""The Reference in leg lengths, against the book's platform and finite differences."""

import json
from pathlib import Path

import numpy as np

from hil.config import Pose, WaypointReference
from hil.loop.reference import complete
from hil.robot.geometry import Platform
from hil.trajectory import build_trajectory

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
        reference = complete(PLATFORM, TRAJECTORY.sample(state["t"]))
        np.testing.assert_allclose(reference.q, state["length"], rtol=0, atol=1e-9)
        np.testing.assert_allclose(reference.dq, state["rate"], rtol=0, atol=1e-9)


def test_leg_acceleration_is_the_derivative_of_the_rate():
    h = 1e-3
    for t in np.linspace(0.05, 0.95, 19):
        ddq = complete(PLATFORM, TRAJECTORY.sample(t)).ddq
        rate = {k: complete(PLATFORM, TRAJECTORY.sample(t + k * h / 2)).dq for k in (-2, -1, 1, 2)}
        expected = (4 * (rate[1] - rate[-1]) / h - (rate[2] - rate[-2]) / (2 * h)) / 3
        np.testing.assert_allclose(ddq, expected, rtol=0, atol=1e-8)


def test_the_pose_passes_through_untouched():
    sample = TRAJECTORY.sample(0.3)
    reference = complete(PLATFORM, sample)
    assert reference.p is sample.p
    assert reference.R is sample.R
    assert reference.twist is sample.twist
    assert reference.dtwist is sample.dtwist
