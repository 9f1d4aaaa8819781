"""Moves from rest to rest between the paths: the approach, and those at set-up speed."""

from math import radians, sqrt

import numpy as np

from drivers.arrays import Array
from hil.config.operator import OperatorSettings
from hil.loop.parts import Parts
from hil.loop.reference import farthest_leg_m
from hil.mathematics.rotations import relative_rotation
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
