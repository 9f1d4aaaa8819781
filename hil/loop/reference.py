"""The reference of a tick (pose, twist, leg lengths and rates), and the force ramps around it."""

from typing import Any, NamedTuple

import numpy as np

from drivers.arrays import ZERO6, Array
from drivers.compiled.compiler import MATRIX, VECTOR, helper, kernel, record
from drivers.signals import Mode
from drivers.tick_columns import TICK, Record, copy_of, new_record, part
from hil.control.law import Law
from hil.mathematics.vectors import add, at, cross, dot, rotate, row
from hil.robot.geometry import Platform
from hil.robot.kinematics_kernels import leg, leg_motion
from hil.trajectory.path import PoseSample

_LOADING = int(Mode.LOADING)


@helper
def fill(a: Array, b: Array, p: Array, R: Array, twist: Array, dtwist: Array, tick: Any) -> None:
    """Fill in a tick's reference as `fill_reference` does; a, b (6, 3) m: joints of base and platform."""
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
    """Fill in the reference columns of a tick from a record of SAMPLE; a, b (6, 3) m: joints."""
    fill(a, b, sample.p, sample.R, sample.twist, sample.dtwist, tick)


def fill_reference(platform: Platform, sample: PoseSample, tick: Record) -> None:
    """Fill p_d to dtwist_d with the sample, and q_d, dq_d = J twist_d, ddq_d = J dtwist_d + (dJ/dt) twist_d.

    An unreachable pose gives lengths outside the hard ends, which `hil check` and safety refuse.
    """
    _fill(platform.base_joints, platform.platform_joints, *sample, tick)


_fill = kernel(MATRIX, MATRIX, VECTOR, MATRIX, VECTOR, VECTOR, record(TICK, *part("reference")))(fill)


def farthest_leg_m(platform: Platform, a: PoseSample, b: PoseSample) -> float:
    """Largest difference, over the legs, between the leg lengths of two samples, m."""
    one, other = new_record(), new_record()
    fill_reference(platform, a, one)
    fill_reference(platform, b, other)
    return float(np.abs(other["q_d"] - one["q_d"]).max())


@helper
def smoothstep(x: float) -> float:
    """Smooth step 10 x^3 - 15 x^4 + 6 x^5 of x limited to 0 .. 1; slope and curvature are 0 at both ends."""
    x = min(max(x, 0.0), 1.0)
    return x * x * x * (10.0 + x * (6.0 * x - 15.0))


@helper
def holding_share(mode: int, elapsed_s: float, load_s: float) -> float:
    """Share, 0..1, of the holding force that acts in LOADING or UNLOADING; their ramps take `load_s` > 0 s.

    LOADING begins with a brake test of the same duration, without force.
    """
    if mode == _LOADING:
        return smoothstep((elapsed_s - load_s) / load_s)
    return 1.0 - smoothstep(elapsed_s / load_s)


def tau_at_rest(law: Law, platform: Platform, tick: Record, sample: PoseSample, *, on_it: bool) -> Array:
    """Law's forces (6,) N at rest, without load, with the sample as reference; resets the law.

    on_it: True to evaluate it at the sample's pose; False: at the pose measured in this tick.
    """
    at_rest = copy_of(tick)
    at_rest["wrench"] = 0.0
    fill_reference(platform, sample, at_rest)
    if on_it:
        for name in ("q", "p", "R"):
            at_rest[name] = at_rest[name + "_d"]
        at_rest["dq"] = at_rest["twist"] = ZERO6
    law.reset()
    law.effort(at_rest)
    law.reset()
    return at_rest["tau_law"]


class LearnedForces(NamedTuple):
    """Leg forces from earlier runs, over the time of a reference and the end of the way to its start."""

    tau: Array
    """(n, 6) N at start_s, start_s + step_s, ... Read-only."""
    start_s: float
    """Time of the first row relative to the start of the reference, s, at most 0."""
    step_s: float
    fade_s: float
    """Time in which the forces fade in and out, s."""
