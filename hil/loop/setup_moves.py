"""Moves from rest to rest between the paths: the approach, and those at set-up speed.

The latter no file has, so each is judged before it is followed, a few poses a tick while the platform rests.
"""

from collections.abc import Callable
from math import ceil, hypot, radians, sqrt

import numpy as np

from drivers.arrays import Array
from hil.config.running import OperatorSettings
from hil.loop.parts import Parts
from hil.loop.reference import farthest_leg_m
from hil.mathematics.rotations import relative_rotation
from hil.robot.geometry import Platform
from hil.signals import explain
from hil.trajectory.move import GeodesicMove
from hil.trajectory.path import PoseSample

PEAK = 1.875
"""Largest speed of a quintic over its mean."""


def approach(parts: Parts, here: PoseSample, period_s: float) -> GeodesicMove:
    """Return the move from a pose at rest to the start of the reference."""
    start, engage = parts.trajectory.sample(0.0), parts.engage
    farthest = farthest_leg_m(parts.platform, here, start)
    duration = max(farthest / engage.approach_speed_m_s, engage.blend_s, period_s)
    return GeodesicMove(here.p, here.R, start.p, start.R, duration)


def at_setup_speed(
    settings: OperatorSettings, least_s: float, here: PoseSample, there: PoseSample
) -> GeodesicMove:
    """Return the move between two poses that is nowhere faster than the set-up speed.

    It takes `least_s` at least, and its largest acceleration is 3.1 times the set-up speed over that.
    """
    way = _length(there.p - here.p)
    turn = _length(relative_rotation(np.array(here.R, order="C"), np.array(there.R, order="C")))
    longest = max(way / settings.setup_speed_m_s, turn / radians(settings.setup_speed_deg_s))
    return GeodesicMove(here.p, here.R, there.p, there.R, max(PEAK * longest, least_s))


def _length(vector: Array) -> float:
    """Return the length of a vector (3,), without BLAS."""
    x, y, z = vector.tolist()
    return sqrt(x * x + y * y + z * z)


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
