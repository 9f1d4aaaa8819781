"""Columns of a tick: labels, units, and the records made of them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from drivers import tick_columns as t
from drivers.signals import NEVER


@pytest.mark.parametrize(
    ("name", "labels", "units"),
    [
        ("tick", ["tick"], [""]),
        ("tau", [f"tau.leg_{k}" for k in range(6)], ["N"] * 6),
        ("p", ["p.x", "p.y", "p.z"], ["m"] * 3),
        ("R", [f"R.{a}{b}" for a in "xyz" for b in "xyz"], ["1"] * 9),
        ("twist", [f"twist.{k}" for k in ("vx", "vy", "vz", "wx", "wy", "wz")], ["m/s"] * 3 + ["rad/s"] * 3),
        ("wrench", [f"wrench.{k}" for k in ("fx", "fy", "fz", "mx", "my", "mz")], ["N"] * 3 + ["N m"] * 3),
        ("pose_std", [f"pose_std.{k}" for k in ("x", "y", "z", "rx", "ry", "rz")], ["m"] * 3 + ["rad"] * 3),
        ("J", [f"J.{k}" for k in range(36)], ["m"] * 18 + ["1"] * 18),
    ],
)
def test_labels_and_units_of_the_log_columns_equal_the_expected_table(name, labels, units):
    column = t.COLUMNS[name]
    assert ([*column.labels], [*column.units], column.size) == (labels, units, len(labels))


def test_new_record_of_a_control_period_has_the_values_that_mean_not_yet_measured():
    record: Any = t.new_record()
    assert (record["tick"], record["age"].tolist()) == (-1, [NEVER] * 6)
    nowhere = {name for name in t.COLUMNS if np.isnan(record[name].astype(float)).all()}
    sensed = {"tracker_pose", "imu", "inclination", "length_sensor", "force_sensor"}
    lyapunov = {f"lyapunov{k}" for k in ("", "_rate", "_bound", "_share")}
    gaps = {"sensor_share", "length_gap", "length_gap_now", "tracker_gap"}
    assert nowhere == {"t_d", "encoder_share"} | lyapunov | sensed | gaps
    never = {name for name in t.COLUMNS if name.endswith("_age") and np.isposinf(record[name]).all()}
    assert len(never) == len(sensed) + 1, "an age of each, and of the wrench sensor"
    assert not any(record[name].any() for name in set(t.COLUMNS) - nowhere - never - {"tick", "age"})
    other = t.copy_of(record)
    other["tick"] = 5
    assert [int(each["tick"]) for each in (record, t.FIRST, t.new_record())] == [-1, -1, -1]
