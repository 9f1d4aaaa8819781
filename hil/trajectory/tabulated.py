"""A trajectory evaluated before the run, at the loop's ticks."""

import numpy as np

from drivers.errors import ConfigurationError
from hil.trajectory.path import PoseSample, Trajectory

BYTES_PER_TICK = 8 * (3 + 9 + 6 + 6)
LARGEST_MB = 256


class TabulatedTrajectory:
    """`trajectory` read from a table of its samples at whole multiples of `period_s`, with the same bits.

    Other instants, as a stop along the path has them, are evaluated when they are asked for. Raises
    ConfigurationError for a trajectory without an end, or one whose table would be too large.
    """

    def __init__(self, trajectory: Trajectory, period_s: float) -> None:
        self.duration_s = require_end(trajectory)
        self._trajectory = trajectory
        self._period = period_s
        ticks = int(self.duration_s / period_s) + 2
        size = ticks * BYTES_PER_TICK * 1e-6
        if size > LARGEST_MB:
            raise ConfigurationError(
                f"reference.evaluation: the table of {ticks} ticks would take {size:.0f} MB, allowed: at "
                f"most {LARGEST_MB}; evaluate it online."
            )
        samples = [trajectory.sample(k * period_s) for k in range(ticks)]
        self._table = tuple(np.array(column) for column in zip(*samples, strict=True))
        for column in self._table:
            column.flags.writeable = False
        self._ticks = ticks

    def sample(self, t: float) -> PoseSample:
        """Return the sample at t (s); see `Trajectory`."""
        k = round(t / self._period)
        if 0 <= k < self._ticks and k * self._period == t:
            p, R, twist, dtwist = self._table
            return PoseSample(p[k], R[k], twist[k], dtwist[k])
        return self._trajectory.sample(t)


def require_end(trajectory: Trajectory) -> float:
    """Return the duration in s of a trajectory. Raises ConfigurationError when it goes on until stopped."""
    if trajectory.duration_s is None:
        raise ConfigurationError(
            "reference.evaluation: offline evaluates the whole path before the run, and this one has no end; "
            "give it one (duration_s, periods), or evaluate it online."
        )
    return trajectory.duration_s
