"""Which poses a set-point may send the platform to, and which a move may lead through."""

import math

import numpy as np

from drivers.arrays import Array
from drivers.compiled.compiler import INTEGER, MATRIX, REAL, VECTOR, kernel
from drivers.signals import Refusal
from hil.config.limits import LimitSettings
from hil.mathematics.linear_algebra import condition_kernel
from hil.mathematics.rotations import rotation_motion_kernel
from hil.robot.dynamics import Model
from hil.robot.dynamics_kernels import inverse_dynamics_kernel
from hil.robot.geometry import Platform
from hil.robot.kinematics_kernels import jacobian_kernel, leg_lengths_kernel, lengths_and_jacobian
from hil.safety.finite import all_finite
from hil.safety.stroke import overspeed, too_fast_for_end
from hil.trajectory.path import PoseSample

CLEARANCE_M = 1e-3
"""Room that set-points leave before the soft ends, beyond which moving on is a fault: for the law's error,
and for the way between two poses that are judged."""
_NOT_A_POSE, _STROKE = int(Refusal.NOT_A_POSE), int(Refusal.STROKE)
_CONDITION, _FORCE, _SPEED = int(Refusal.CONDITION), int(Refusal.FORCE), int(Refusal.SPEED)


@kernel(MATRIX, MATRIX, REAL, VECTOR, INTEGER, VECTOR, VECTOR, REAL, REAL, REAL, REAL)
def judge(
    a: Array, b: Array, radius: float, constants: Array, code: int,
    chi: Array, ddchi: Array, low: float, high: float, condition: float, force: float,
) -> int:  # fmt: skip
    """Return the bits of Refusal against the six words chi (6,) m, rad; see `Admission`."""
    if not all_finite(chi) or chi[3] * chi[3] + chi[4] * chi[4] + chi[5] * chi[5] > math.pi * math.pi:
        return _NOT_A_POSE
    still = np.zeros(6)
    p = chi[:3].copy()
    R = rotation_motion_kernel(chi[3:], still[:3], still[:3])[0]
    q = leg_lengths_kernel(a, b, p, R)
    for i in range(6):
        if q[i] < low or q[i] > high:
            return _STROKE
    if not condition_kernel(jacobian_kernel(a, b, p, R), radius) <= condition:
        return _CONDITION
    rest = inverse_dynamics_kernel(constants, code, p, R, still, still, still)
    most = np.abs(rest)
    for j in range(6):
        one = np.zeros(6)
        one[j] = ddchi[j]
        most += np.abs(inverse_dynamics_kernel(constants, code, p, R, still, one, still) - rest)
    for i in range(6):
        if not most[i] <= force:
            return _FORCE
    return 0


@kernel(MATRIX, MATRIX, REAL, VECTOR, INTEGER, VECTOR, MATRIX, VECTOR, VECTOR, VECTOR)
def judge_moving(
    a: Array, b: Array, radius: float, constants: Array, code: int,
    p: Array, R: Array, twist: Array, dtwist: Array, limits: Array,
) -> int:  # fmt: skip
    """Return the bits of Refusal against a sample of a move; see `Admission.on_the_way`.

    limits (6,): lengths from and to, condition, force, rate of a leg, deceleration.
    """
    low, high, condition, force, speed, deceleration = limits
    q, J, dq = np.empty(6), np.empty((6, 6)), np.zeros(6)
    lengths_and_jacobian(a, b, p, R, q, J)
    for i in range(6):
        for j in range(6):
            dq[i] += J[i, j] * twist[j]
        if not low <= q[i] <= high:
            return _STROKE
    if not condition_kernel(J, radius) <= condition:
        return _CONDITION
    if overspeed(dq, speed) or too_fast_for_end(q, dq, low, high, deceleration):
        return _SPEED
    tau = inverse_dynamics_kernel(constants, code, p, R, twist, dtwist, np.zeros(6))
    for i in range(6):
        if not abs(tau[i]) <= force:
            return _FORCE
    return 0


class Admission:
    """Refuses poses at or beyond a soft end of the stroke, near a singularity, or that take too much force.

    At an end is nearer than CLEARANCE_M. The force is what holds the platform at rest there plus, at worst,
    what the largest acceleration of each axis takes, ddchi (6,) m/s^2, rad/s^2.
    """

    def __init__(
        self,
        platform: Platform,
        model: Model,
        limits: LimitSettings,
        length_min: float,
        length_max: float,
        drive_force_limit: float,
        ddchi: Array,
    ) -> None:
        self._robot = (
            platform.base_joints,
            platform.platform_joints,
            platform.radius,
            model.constants,
            model.code,
        )
        self._limits = (
            np.array(ddchi, float),
            length_min + limits.stroke_margin_m + CLEARANCE_M,
            length_max - limits.stroke_margin_m - CLEARANCE_M,
            limits.condition,
            min(limits.force_N, drive_force_limit),
        )
        self._moving = np.array(
            [
                length_min + limits.stroke_margin_m,
                length_max - limits.stroke_margin_m,
                *self._limits[3:],
                limits.speed_m_s,
                limits.deceleration_m_s2,
            ]
        )

    def __call__(self, chi: Array) -> int:
        """Return the bits of Refusal against the six words chi (6,) m, rad; 0 for a good pose."""
        ddchi, *limits = self._limits
        return judge(*self._robot, chi, ddchi, *limits)

    def on_the_way(self, s: PoseSample) -> int:
        """Return the bits of Refusal against a sample of a move: what `hil check` asks of a reference.

        Soft ends of the stroke, condition, rates of the legs, the braking way before a soft end, and force.
        """
        R = np.ascontiguousarray(s.R)
        return judge_moving(*self._robot, s.p, R, s.twist, s.dtwist, self._moving)
