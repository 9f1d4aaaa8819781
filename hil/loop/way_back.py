"""The straight ways that no file has: back to the path after a jog, and to the first pose to park.

Pure. Each is judged before it is followed, a few poses a tick while the platform rests.
"""

from collections.abc import Callable
from math import ceil, hypot

from hil.robot.geometry import Platform
from hil.signals import explain
from hil.trajectory.move import GeodesicMove
from hil.trajectory.path import PoseSample

APART_M = 5e-3
"""No joint of the platform moves farther from one pose that is judged to the next."""
LEAST, MOST = 16, 1000
"""Poses of a way, beside its start."""
PER_TICK = 2
"""Poses judged in one tick."""


class Inspection:
    """A move under judgement. Mutable state: how many of its poses are judged, and why one is refused."""

    def __init__(
        self, platform: Platform, judge: Callable[[PoseSample], int], name: str, move: GeodesicMove
    ) -> None:
        """Take the judge of samples, bits of Refusal, and what the move is called."""
        self.move, self._judge, self._name = move, judge, name
        reach = max(hypot(*joint) for joint in platform.platform_joints.tolist())
        self._steps = min(max(ceil(move.travel_m(reach) / APART_M), LEAST), MOST)
        self._next = 0
        self.refusal = ""
        """Why it cannot be followed; empty as far as it has been judged."""

    def step(self) -> bool:
        """Judge the next poses; return whether all have been, or one is refused."""
        for _ in range(PER_TICK):
            if self.refusal or self._next > self._steps:
                break
            t = self.move.duration_s * self._next / self._steps
            against = self._judge(self.move.sample(t))
            if against:
                at = f"{100.0 * self._next / self._steps:.0f} %"
                self.refusal = f"{self._name}: not followed, since {at} along it {explain(against)}"
            self._next += 1
        return bool(self.refusal) or self._next > self._steps
