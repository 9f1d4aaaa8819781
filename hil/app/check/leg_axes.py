"""Detects leg axes that cross, mostly because a list of joints is in the wrong order."""

from itertools import combinations

import numpy as np

from drivers.signals import LEGS
from hil.app.check.subject import Subject
from hil.app.configuration.platform import pose_arrays
from hil.robot.kinematics_kernels import segment_distance

NEAR = 0.02
"""Distance of two leg axes, as a share of the shortest leg, below which they probably cross by mistake."""
INSTANTS = 101
"""Number of instants of the reference at which leg axes are compared."""


def crossing(s: Subject) -> str:
    """Text about the two legs whose axes come nearest, if too near; else "". Shared joints do not count."""
    a, b = s.model.platform.base_joints, s.model.platform.platform_joints
    ends = s.span_s * (1 - 1e-12)
    path = [s.trajectory.sample(t)[:2] for t in np.linspace(0.0, ends, INSTANTS).tolist()]
    found = []
    for p, R in [pose_arrays(s.c.platform.home), *path]:
        tips = p + b @ R.T
        legs = tips - a
        near = NEAR * float(np.linalg.norm(legs, axis=1).min())
        for i, j in combinations(range(LEGS), 2):
            if min(np.linalg.norm(a[i] - a[j]), np.linalg.norm(tips[i] - tips[j])) > near:
                apart = segment_distance(*map(tuple, (a[i], legs[i], a[j], legs[j])))
                found += [(apart, i, j)] * (apart < near)
    if not found:
        return ""
    apart, i, j = min(found)
    return f"{i} and {j} come within {1e3 * apart:.2g} mm"
