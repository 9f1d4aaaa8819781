"""Records of a tick for tests: chosen columns, and the forces of a law."""

from __future__ import annotations

from math import nan
from typing import Any

from drivers.arrays import Array
from drivers.tick_columns import Record, copy_of, new_record
from hil.loop.reference import fill_reference
from hil.robot.geometry import Platform
from hil.robot.kinematics import jacobian
from hil.trajectory.path import PoseSample


def altered(tick: Record, /, **columns: Any) -> Record:
    """Copy of a tick with other columns."""
    record = copy_of(tick)
    for name, value in columns.items():
        record[name] = value
    return record


def record_of(**columns: Any) -> Record:
    """New record with these columns."""
    return altered(new_record(), **columns)


def referred(platform: Platform, sample: PoseSample, t: float = nan, /, **columns: Any) -> Record:
    """Record with the reference of a sample at the time t, s, and these columns."""
    record = record_of(t_d=t, **columns)
    fill_reference(platform, sample, record)
    return record


def arrived(platform: Platform, sample: PoseSample, t: float = nan, /, **columns: Any) -> Record:
    """Record of a platform on the reference of a sample, except for these columns."""
    record = referred(platform, sample, t)
    here = {name: record[name + "_d"] for name in ("q", "dq", "p", "R", "twist")}
    return altered(record, **here | {"J": jacobian(platform, sample.p, sample.R)} | columns)


def asked(law: Any, tick: Record, /, **columns: Any) -> Array:
    """Forces (6,) N of a law in a tick with these columns."""
    seen = altered(tick, **columns)
    law.effort(seen)
    return seen["tau_law"]
