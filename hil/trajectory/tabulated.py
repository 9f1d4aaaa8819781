"""A trajectory evaluated before the run, at the loop's ticks."""

from typing import Any

import numpy as np

from drivers.compiled.compiler import REAL, record
from drivers.compiled.pointed import Callee, address_of, call, context_of, data_at, pointed
from drivers.errors import ConfigurationError
from hil.trajectory.path import SAMPLE, CompiledTrajectory, Trajectory, callee_of, copy_sample, sample_at

BYTES_PER_TICK = SAMPLE.itemsize
LARGEST_MB = 256
TABLE = np.dtype(
    [("function", "<i8"), ("context", "<i8"), ("samples", "<i8"), ("count", "<i8"), ("period", "<f8")]
)


@pointed(record(TABLE), REAL, record(SAMPLE))
def look_up(table: Any, t: float, into: Any) -> int:
    """Fill the sample from the table, or, between its instants, from the trajectory that it was made of."""
    k = np.rint(t / table.period)
    if 0.0 <= k < table.count and k * table.period == t:
        copy_sample(sample_at(table.samples + int(k) * BYTES_PER_TICK), into)
        return 0
    status: int = call(table.function, (table.context, t, address_of(into)))
    return status


class TabulatedTrajectory(CompiledTrajectory):
    """`trajectory` read from a table of its samples at whole multiples of `period_s`, with the same bits.

    Other instants, as a stop along the path has them, are evaluated when they are asked for. Raises
    ConfigurationError for a trajectory without an end, or one whose table would be too large.
    """

    def __init__(self, trajectory: Trajectory, period_s: float) -> None:
        self.duration_s = require_end(trajectory)
        self._period = period_s
        ticks = int(self.duration_s / period_s) + 2
        size = ticks * BYTES_PER_TICK * 1e-6
        if size > LARGEST_MB:
            raise ConfigurationError(
                f"reference.evaluation: the table of {ticks} ticks would take {size:.0f} MB, allowed: at "
                f"most {LARGEST_MB}; evaluate it online."
            )
        samples = np.array([tuple(trajectory.sample(k * period_s)) for k in range(ticks)], SAMPLE)
        path = callee_of(trajectory)
        table = context_of(
            TABLE,
            function=path.address,
            context=path.context,
            samples=samples,
            count=ticks,
            period=period_s,
        )
        self.callee = Callee(look_up.address, data_at(table), (table, samples, path))


def require_end(trajectory: Trajectory) -> float:
    """Return the duration in s of a trajectory. Raises ConfigurationError when it goes on until stopped."""
    if trajectory.duration_s is None:
        raise ConfigurationError(
            "reference.evaluation: offline evaluates the whole path before the run, and this one has no end; "
            "give it one (duration_s, periods), or evaluate it online."
        )
    return trajectory.duration_s
