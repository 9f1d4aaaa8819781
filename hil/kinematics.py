"""Leg lengths, Jacobian, and the pose from leg lengths; the code is in `hil.robot.kinematics`."""

from hil.robot.kinematics import (
    KinematicsError,
    Pose,
    condition,
    continue_kinematics,
    forward_kinematics,
    jacobian,
    jacobian_rate,
    leg_lengths,
)

__all__ = [
    "KinematicsError",
    "Pose",
    "condition",
    "continue_kinematics",
    "forward_kinematics",
    "jacobian",
    "jacobian_rate",
    "leg_lengths",
]
