"""Sensors next to the drives are decoded into columns, whatever the pose is estimated from."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.loop.bench import changed
from tests.loop.fusion_runs import SOON, track

SENSORS: dict[str, Any] = {
    "bus": {"max_load_percent": 90},
    "sensors": {"tracker": {"rate_Hz": 200}, "imu": {"rate_Hz": 500}, "wrench": {"rate_Hz": 500}},
    "plant": {"sensors": {"tracker": {"position_noise_m": 0, "orientation_noise_deg": 0, "latency_ms": 5}}},
}


@pytest.fixture(scope="module")
def rows():
    """A run with pose `legs` and three sensors."""
    return track(changed(changed("virtual", **SOON), **SENSORS)).rows


def test_tracker_that_is_not_used_for_pose_fusion_is_logged_with_its_age(rows):
    age_s = rows["tracker_age"]
    assert age_s.min() > 4.5e-3
    assert age_s.max() < 11.1e-3
    then_s = rows["t_ns"] * 1e-9 - age_s
    for k, axis in enumerate("xyz"):
        legs = np.interp(then_s, rows["t_ns"] * 1e-9, rows["p"][:, k])
        settled = then_s > rows["t_ns"][0] * 1e-9
        assert np.abs(rows["tracker_pose"][settled, k] - legs[settled]).max() < 2e-4, axis
    turned = Rotation.from_matrix(rows["R"]).as_rotvec()
    assert np.abs(rows["tracker_pose"][:, 3:] - turned).max() < 0.02


def test_logged_age_of_imu_and_wrench_sensor_is_at_most_their_sample_period(rows):
    assert np.abs(rows["imu"][:, 5] - 9.81).max() < 6.0
    assert rows["imu"][:, 3:].std() > 0.01
    for name in ("imu_age", "wrench_sensor_age"):
        assert 0.0 <= rows[name].min() <= rows[name].max() < 3.1e-3, name
