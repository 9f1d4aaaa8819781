"""A trajectory that stays at one pose."""

import numpy as np

from drivers.arrays import Array
from hil.trajectory.path import PoseSample


class HoldTrajectory:
    """Stay at p (3,) m, R (3, 3), base frame, for `duration_s`, or until stopped when it is None."""

    def __init__(self, p: Array, R: Array, duration_s: float | None = None) -> None:
        self.duration_s = duration_s
        self._sample = PoseSample(np.array(p, float), np.array(R, float, order="C"), np.zeros(6), np.zeros(6))

    def sample(self, t: float) -> PoseSample:  # noqa: ARG002
        """Return the pose, at rest: the same arrays each time."""
        return self._sample
