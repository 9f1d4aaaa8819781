"""Tick records for tests, with chosen values of some columns, and the forces of a law for a record."""

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
    """Copy of a tick's record in which the given columns have other values."""
    record = copy_of(tick)
    for name, value in columns.items():
        record[name] = value
    return record


def record_of(**columns: Any) -> Record:
    """New record of a tick in which the given columns have values."""
    return altered(new_record(), **columns)


def referred(platform: Platform, sample: PoseSample, t: float = nan, /, **columns: Any) -> Record:
    """Record of a tick whose reference is `sample` at the time t, s; other columns as given."""
    record = record_of(t_d=t, **columns)
    fill_reference(platform, sample, record)
    return record


def arrived(platform: Platform, sample: PoseSample, t: float = nan, /, **columns: Any) -> Record:
    """Record of a tick in which the platform is exactly on the reference `sample`; other columns as given."""
    record = referred(platform, sample, t)
    here = {name: record[name + "_d"] for name in ("q", "dq", "p", "R", "twist")}
    return altered(record, **here | {"J": jacobian(platform, sample.p, sample.R)} | columns)


def asked(law: Any, tick: Record, /, **columns: Any) -> Array:
    """Leg forces (6,) N that a law computes for a tick in which the given columns have other values."""
    seen = altered(tick, **columns)
    law.effort(seen)
    return seen["tau_law"]
