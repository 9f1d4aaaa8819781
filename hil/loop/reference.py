"""From a trajectory's sample to the reference of a tick: the same instant in leg lengths."""

from typing import Any

import numpy as np

from drivers.arrays import Array
from drivers.compiled.compiler import MATRIX, VECTOR, helper, kernel, record
from drivers.tick_columns import TICK, Record, new_record, part
from hil.mathematics.vectors import add, at, cross, dot, rotate, row
from hil.robot.geometry import Platform
from hil.robot.kinematics_kernels import leg, leg_motion
from hil.trajectory.path import PoseSample


@helper
def fill(a: Array, b: Array, p: Array, R: Array, twist: Array, dtwist: Array, tick: Any) -> None:
    """Fill the reference of a tick; see `fill_reference`. a, b (6, 3) m: joints of base and platform."""
    tick.p_d[:] = p
    tick.R_d[:] = R
    tick.twist_d[:] = twist
    tick.dtwist_d[:] = dtwist
    v = at(twist, 0)
    w = at(twist, 3)
    for i in range(6):
        r = rotate(R, row(b, i))
        l, s = leg(row(a, i), r, at(p, 0))
        u, dl, ds = leg_motion(l, s, r, v, w)
        du = add(add(at(dtwist, 0), cross(at(dtwist, 3), r)), cross(w, cross(w, r)))
        tick.q_d[i] = l
        tick.dq_d[i] = dl
        tick.ddq_d[i] = dot(ds, u) + dot(s, du)


@helper
def fill_sample(a: Array, b: Array, sample: Any, tick: Any) -> None:
    """Fill the reference of a tick with a record of SAMPLE."""
    fill(a, b, sample.p, sample.R, sample.twist, sample.dtwist, tick)


def fill_reference(platform: Platform, sample: PoseSample, tick: Record) -> None:
    """Fill p_d to dtwist_d with the sample, and q_d, dq_d = J twist_d, ddq_d = J dtwist_d + (dJ/dt) twist_d.

    An unreachable pose gives lengths outside the hard ends, which `hil check` and safety refuse.
    """
    _fill(platform.base_joints, platform.platform_joints, *sample, tick)


_fill = kernel(MATRIX, MATRIX, VECTOR, MATRIX, VECTOR, VECTOR, record(TICK, *part("reference")))(fill)


def farthest_leg_m(platform: Platform, a: PoseSample, b: PoseSample) -> float:
    """Return by how much the lengths of the legs differ at most between two samples, m."""
    one, other = new_record(), new_record()
    fill_reference(platform, a, one)
    fill_reference(platform, b, other)
    return float(np.abs(other["q_d"] - one["q_d"]).max())
