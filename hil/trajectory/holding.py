"""A trajectory that stays at one pose."""

from typing import Any

from drivers.arrays import ZERO6, Array
from drivers.compiled.compiler import REAL, record
from drivers.compiled.pointed import Callee, data_at, pointed
from hil.trajectory.path import SAMPLE, CompiledTrajectory, context_of, copy_sample


@pointed(record(SAMPLE), REAL, record(SAMPLE))
def stay(pose: Any, _t: float, into: Any) -> int:
    """Fill the sample with the pose, at rest."""
    copy_sample(pose, into)
    return 0


class HoldTrajectory(CompiledTrajectory):
    """Stay at p (3,) m, R (3, 3), base frame, for `duration_s`, or until stopped when it is None."""

    def __init__(self, p: Array, R: Array, duration_s: float | None = None) -> None:
        self.duration_s = duration_s
        pose = context_of(SAMPLE, p=p, R=R, twist=ZERO6, dtwist=ZERO6)
        self.callee = Callee(stay.address, data_at(pose), pose)
