"""Checks that accept or refuse the operator's set-points and moves before the platform follows them."""

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from drivers.arrays import Array
from drivers.compiled.compiler import INTEGER, MATRIX, REAL, VECTOR, kernel, record
from drivers.compiled.pointed import Callee, context_of, data_at, pointed, reals_at
from drivers.signals import Refusal
from hil.config.limits import LimitSettings
from hil.mathematics.linear_algebra import condition_kernel
from hil.mathematics.rotations import rotation_motion
from hil.mathematics.vectors import at, scale
from hil.robot.dynamics import Model
from hil.robot.dynamics_kernels import SIZE, inverse_dynamics_kernel
from hil.robot.geometry import Platform
from hil.robot.kinematics_kernels import jacobian_kernel, leg_lengths_kernel
from hil.safety.guard import WINDOW_S
from hil.safety.motion import overspeed, too_fast_for_end
from hil.safety.signals import all_finite
from hil.signals import SetPoint
from hil.trajectory.live import LiveTrajectory
from hil.trajectory.override import CURVATURE, PEAK
from hil.trajectory.path import PoseSample

CLEARANCE_M = 1e-3
"""Distance of set-points from the soft ends, beyond which outward motion is a fault. It leaves room for the
tracking error, and for the path between two checked poses."""
_STILL = (0.0, 0.0, 0.0)
_NOT_A_POSE, _STROKE = int(Refusal.NOT_A_POSE), int(Refusal.STROKE)
_CONDITION, _FORCE, _SPEED = int(Refusal.CONDITION), int(Refusal.FORCE), int(Refusal.SPEED)


ADMISSION = np.dtype(
    [
        ("base_joints", "<f8", (6, 3)), ("platform_joints", "<f8", (6, 3)), ("radius", "<f8"),
        ("constants", "<i8"), ("code", "<i8"), ("ddchi", "<f8", (6,)),
        *((name, "<f8") for name in ("low", "high", "soft_min", "soft_max")),
        *((name, "<f8") for name in ("condition", "force", "speed", "deceleration")),
    ]
)  # fmt: skip
"""Robot geometry, address of the model's constants, largest axis accelerations, and limits: leg lengths of a
set-point (low, high) and on the way (soft), condition number, force, rate and deceleration of a leg."""


@pointed(record(ADMISSION), INTEGER)
def judge(k: Any, words: int) -> int:
    """Refusal bits of `Admission`, 0: none, for the pose (6,) m, rad at the address `words`."""
    chi, constants = reals_at(words, 6), reals_at(k.constants, SIZE)
    if not all_finite(chi) or chi[3] * chi[3] + chi[4] * chi[4] + chi[5] * chi[5] > math.pi * math.pi:
        return _NOT_A_POSE
    still, R = np.zeros_like(chi), np.empty((3, 3))
    p = chi[:3]
    rotation_motion(at(chi, 3), _STILL, _STILL, R)
    q = leg_lengths_kernel(k.base_joints, k.platform_joints, p, R)
    for i in range(6):
        if q[i] < k.low or q[i] > k.high:
            return _STROKE
    if not condition_kernel(jacobian_kernel(k.base_joints, k.platform_joints, p, R), k.radius) <= k.condition:
        return _CONDITION
    rest = inverse_dynamics_kernel(constants, k.code, p, R, still, still, still)
    most = np.abs(rest)
    for j in range(6):
        one = np.zeros_like(chi)
        one[j] = k.ddchi[j]
        most += np.abs(inverse_dynamics_kernel(constants, k.code, p, R, still, one, still) - rest)
    for i in range(6):
        if not most[i] <= k.force:
            return _FORCE
    return 0


@kernel(record(ADMISSION), VECTOR, MATRIX, VECTOR, VECTOR)
def judge_moving(k: Any, p: Array, R: Array, twist: Array, dtwist: Array) -> int:
    """Refusal bits, 0: none, for one sample of a move, by the checks of `Admission.on_the_way`."""
    q = leg_lengths_kernel(k.base_joints, k.platform_joints, p, R)
    J = jacobian_kernel(k.base_joints, k.platform_joints, p, R)
    dq = np.zeros_like(twist)
    for i in range(6):
        for j in range(6):
            dq[i] += J[i, j] * twist[j]
        if not k.soft_min <= q[i] <= k.soft_max:
            return _STROKE
    if not condition_kernel(J, k.radius) <= k.condition:
        return _CONDITION
    if overspeed(dq, k.speed) or too_fast_for_end(q, dq, k.soft_min, k.soft_max, k.deceleration):
        return _SPEED
    tau = inverse_dynamics_kernel(
        reals_at(k.constants, SIZE), k.code, p, R, twist, dtwist, np.zeros_like(twist)
    )
    for i in range(6):
        if not abs(tau[i]) <= k.force:
            return _FORCE
    return 0


@kernel(record(ADMISSION), VECTOR, MATRIX, VECTOR, VECTOR, REAL)
def change_within(k: Any, p: Array, R: Array, twist: Array, dtwist: Array, faster: float) -> float:
    """Largest change, N, of a leg's force within WINDOW_S of a jog near a sample; see `Admission.change_N`.

    faster: largest d sigma/dt over sigma, 1/s. The result is nan if a force is.
    """
    constants, still, most = reals_at(k.constants, SIZE), np.zeros_like(twist), 0.0
    turn, turned = np.empty_like(R), np.empty_like(R)
    moved = p + WINDOW_S * twist[:3]
    rotation_motion(scale(WINDOW_S, at(twist, 3)), _STILL, _STILL, turn)
    for i in range(3):
        for j in range(3):
            turned[i, j] = turn[i, 0] * R[0, j] + turn[i, 1] * R[1, j] + turn[i, 2] * R[2, j]
    rest = inverse_dynamics_kernel(constants, k.code, p, R, still, still, still)
    going = inverse_dynamics_kernel(constants, k.code, p, R, twist, dtwist, still) - rest
    inertia = inverse_dynamics_kernel(constants, k.code, p, R, still, twist, still) - rest
    rest1 = inverse_dynamics_kernel(constants, k.code, moved, turned, still, still, still)
    going1 = inverse_dynamics_kernel(constants, k.code, moved, turned, twist, dtwist, still) - rest1
    inertia1 = inverse_dynamics_kernel(constants, k.code, moved, turned, still, twist, still) - rest1
    for i in range(6):
        by_speed = max(abs(going[i]), abs(going1[i]))
        change = abs(rest1[i] - rest[i]) + by_speed + faster * (abs(inertia[i]) + abs(inertia1[i]))
        if math.isnan(change):
            return math.nan
        most = max(most, change)
    return most


class Admission:
    """Refuses poses near a soft end of the stroke, near a singularity, or with too much leg force.

    Near an end means within CLEARANCE_M. The leg force considered is that of the platform at rest, plus in
    the worst case the largest acceleration of each axis, ddchi (6,) m/s^2, rad/s^2.
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
        stop_s: float,
    ) -> None:
        """Set limits. ddchi (6,) m/s^2, rad/s^2: largest accelerations; stop_s: time to stop a jog, s."""
        soft_min, soft_max = length_min + limits.stroke_margin_m, length_max - limits.stroke_margin_m
        self._record = context_of(
            ADMISSION,
            base_joints=platform.base_joints,
            platform_joints=platform.platform_joints,
            radius=platform.radius,
            constants=model.constants,
            code=model.code,
            ddchi=ddchi,
            low=soft_min + CLEARANCE_M,
            high=soft_max - CLEARANCE_M,
            soft_min=soft_min,
            soft_max=soft_max,
            condition=limits.condition,
            force=min(limits.force_N, drive_force_limit),
            speed=limits.speed_m_s,
            deceleration=limits.deceleration_m_s2,
        )
        self._model = model
        self.callee = Callee(judge.address, data_at(self._record), self)
        """Compiled form of a call: (admission record, address of six words)."""
        self._stop_s, self._window_N = stop_s, limits.force_window_N

    def __call__(self, chi: Array) -> int:
        """Reasons (Refusal bits) to refuse the pose chi (6,) m, rad; 0: accepted."""
        return judge(self._record, np.ascontiguousarray(chi, np.float64))

    def on_the_way(self, s: PoseSample) -> int:
        """Reasons (Refusal bits, 0: none) to refuse one sample of a move, as `hil check` checks a reference.

        Checked are the soft ends of the stroke, condition number, leg rates, braking distance to a soft end,
        and force.
        """
        R = np.ascontiguousarray(s.R)
        return judge_moving(self._record, s.p, R, s.twist, s.dtwist)

    def change_N(self, s: PoseSample, sigma: float) -> float:
        """Largest change, N, of a leg's force within 250 ms of a jog near a sample.

        It adds up the change of weight along the motion, the force due to speed, and the inertia forces of
        start and stop. Start and stop use the largest d sigma/dt between 0 and sigma, the share of the
        sample's speed; see `hil.trajectory.override`. The result is nan if a force is.
        """
        faster = min(PEAK, math.sqrt(CURVATURE * sigma)) / (self._stop_s * sigma) if sigma > 0.0 else 0.0
        R, twist = np.ascontiguousarray(s.R), sigma * s.twist
        return float(change_within(self._record, s.p, R, twist, sigma * sigma * s.dtwist, faster))

    def too_sudden(self, s: PoseSample, sigma: float) -> bool:
        """True where a jog near a sample could change a leg's force by more than limits.force_window_N."""
        return not self.change_N(s, sigma) <= self._window_N


class Counts(NamedTuple):
    """Set-points accepted and refused since the start, and the Refusal bits of this tick."""

    taken: int
    refused: int
    refusal: int


NO_SETPOINTS = Counts(0, 0, 0)


class Steering:
    """Passes accepted set-points to the live trajectory.

    Mutable state: that of the trajectory, the counts, and the answers to the set-points of the last tick.
    `reset` restores the initial state.
    """

    def __init__(self, trajectory: LiveTrajectory, admission: Callable[[Array], int], judge: Callee) -> None:
        """admission: returns the Refusal bits of a pose (6,) m, rad; see `hil.loop.admission`.

        judge: compiled function with the same result, see `LiveTrajectory.advance`.
        """
        self.trajectory = trajectory
        self._admission, self.judge = admission, judge
        self.reset()

    def reset(self) -> None:
        """Reset the trajectory, the counts and the answers."""
        self.trajectory.reset()
        self.counts = NO_SETPOINTS
        self.answers: list[int] = []
        """Refusal bits for each set-point of the last tick, in order."""

    def take(self, setpoints: Sequence[SetPoint], *, tracking: bool) -> None:
        """Check this tick's set-points and move to the last accepted one; refuse all unless `tracking`."""
        taken, refused, refusal = self.counts
        refusal = 0
        if setpoints or self.answers:
            self.answers = []
        for setpoint in setpoints:
            chi = np.array(setpoint)
            against = self._admission(chi) if tracking else int(Refusal.NOT_TRACKING)
            self.answers.append(against)
            refusal |= against
            if against:
                refused += 1
            else:
                taken += 1
                self.trajectory.aim(chi)
        self.counts = Counts(taken, refused, refusal)

    def stopped(self, against: int) -> None:
        """Count a stop of the live trajectory on its way, for which `against` has the Refusal bits."""
        taken, refused, refusal = self.counts
        self.counts = Counts(taken, refused + 1, refusal | against | int(Refusal.ON_THE_WAY))

    @property
    def answered(self) -> bool:
        """True if counts or answers of this tick have to be cleared in the next one."""
        return bool(self.counts.refusal or self.answers)
