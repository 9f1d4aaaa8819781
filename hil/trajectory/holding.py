"""A trajectory that stays at one pose."""

from drivers.arrays import ZERO6, Array
from drivers.compiled.pointed import Callee, context_of, data_at
from hil.trajectory.path import SAMPLE, CompiledTrajectory, kept


class HoldTrajectory(CompiledTrajectory):
    """Stay at p (3,) m, R (3, 3), base frame, for `duration_s`, or until stopped when it is None."""

    def __init__(self, p: Array, R: Array, duration_s: float | None = None) -> None:
        self.duration_s = duration_s
        pose = context_of(SAMPLE, p=p, R=R, twist=ZERO6, dtwist=ZERO6)
        self.callee = Callee(kept.address, data_at(pose), pose)
