"""What `hil check` says of set-points: what all axes at once ask of a leg at the start of a live reference."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drivers.arrays import Array
from hil.app.check.findings import Report
from hil.app.check.setpoints import report_setpoints
from hil.app.configuration.configuration import load
from hil.config.reference import LiveReference

C = load("virtual")
START = {"position_m": [0.4, -0.3, 1.1], "rotation_vector_deg": [10.0, -15.0, 20.0]}
LIVE = LiveReference.model_validate(
    {
        "type": "live",
        "start": START,
        "limits": {
            "velocity_m_s": [0.3, 0.2, 0.1], "velocity_deg_s": [20, 10, 30], "acceleration_m_s2": [1, 2, 0.5],
            "acceleration_deg_s2": [60, 40, 90], "jerk_m_s3": 10, "jerk_deg_s3": 600,
        },
    }
)  # fmt: skip
RATES = np.array([0.3, 0.2, 0.1, *np.deg2rad([20, 10, 30])])
ACCELERATIONS = np.array([1, 2, 0.5, *np.deg2rad([60, 40, 90])])
HOME = {"position_m": [0.0, 0.0, 1.0], "rotation_vector_deg": [0.0, 0.0, 0.0]}


def lengths(pose: dict[str, list[float]], moved: Array) -> Array:
    """Return the leg lengths (6,) m of the robot of `virtual`, moved and turned from a pose, m and rad."""
    a, b = np.array(C.platform.base_joints_m), np.array(C.platform.platform_joints_m)
    R = Rotation.from_rotvec(moved[3:]) * Rotation.from_rotvec(pose["rotation_vector_deg"], degrees=True)
    found: Array = np.linalg.norm(np.array(pose["position_m"]) + moved[:3] + R.apply(b) - a, axis=1)
    return found


def fastest(pose: dict[str, list[float]], words: Array) -> float:
    """Return the largest rate of a leg where each axis moves at its own, one way or the other."""
    h = 1e-6
    ways = (np.array(signs) * words for signs in product((1.0, -1.0), repeat=6))
    return max(float(np.abs(lengths(pose, h * v) - lengths(pose, -h * v)).max()) / (2 * h) for v in ways)


@pytest.mark.parametrize("start", [START, HOME], ids=["start", "home"])
def test_set_points_ask_for_the_worst_ways_of_all_axes_at_the_start(start):
    """A live reference without a start begins at home."""
    reference = LIVE if start is START else LIVE.model_copy(update={"start": None})
    report = Report("", figures={"reference": {}})
    report_setpoints(report, C, reference)
    figures = report.figures["reference"]
    assert figures["setpoint_rate_max_m_s"] == pytest.approx(fastest(start, RATES), rel=1e-6)
    assert figures["setpoint_acceleration_max_m_s2"] == pytest.approx(fastest(start, ACCELERATIONS), rel=1e-6)
