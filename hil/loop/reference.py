"""From a trajectory's sample to the Reference: the same instant in leg lengths."""

from __future__ import annotations

import math

import numpy as np

from drivers.signals import LEGS
from hil.robot.geometry import Platform
from hil.robot.kinematics_kernels import reference_kernel
from hil.signals import Reference
from hil.trajectory import PoseSample


def complete(platform: Platform, sample: PoseSample, t: float = math.nan) -> Reference:
    """Return the Reference of a sample: q, dq = J twist, ddq = J dtwist + (dJ/dt) twist; (6,), m and s.

    t: the sample's time along the configured trajectory, s; nan elsewhere.
    An unreachable pose gives lengths outside the hard ends, which `hil check` and safety refuse.
    """
    p, R, twist, dtwist = sample
    q, dq, ddq = np.empty(LEGS), np.empty(LEGS), np.empty(LEGS)
    reference_kernel(platform.base_joints, platform.platform_joints, p, R, twist, dtwist, q, dq, ddq)
    return Reference(p, R, twist, dtwist, q, dq, ddq, t)
