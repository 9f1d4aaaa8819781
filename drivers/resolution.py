"""How far what a drive family reports and takes may be from what the drive measures and is asked for."""

from typing import NamedTuple, Self

import numpy as np

from drivers.arrays import Array
from drivers.signals import LEGS

SINGLE = 2.0**-24
"""Share by which a number is off as a single, rounded to nearest."""
FARTHEST_m = 2.0
"""No leg is farther from where its drive reads zero."""


class Resolution(NamedTuple):
    """Largest deviations by the steps of the frames; every array is (6,), leg order.

    A field that is rounded is off by half a step; one that may be truncated, at either end, by a whole one.
    """

    length: Array
    """m, of a length that is read."""
    rate: Array
    """m/s, of a rate that is read."""
    force: Array
    """N at the leg, without losses, of a force that is commanded."""
    differences: bool = False
    """Whether a rate is no reading, but the slope at the end of the parabola through three lengths."""

    @classmethod
    def of(
        cls, length: Array | float, rate: Array | float, force: Array | float, *, differences: bool = False
    ) -> Self:
        """Return the deviations; their signs do not count, a value for all legs is repeated."""
        q, dq, f = (np.abs(np.broadcast_to(np.array(x, float), LEGS)) for x in (length, rate, force))
        return cls(q, dq, f, differences)

    @classmethod
    def of_singles(cls) -> Self:
        """Return what singles leave of a length; of rate and force it is less than anything else."""
        return cls.of(SINGLE * FARTHEST_m, 0.0, 0.0)
