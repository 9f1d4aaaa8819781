"""What the compiled pass needs of the motion: where the platform should be, and whether the path has ended.

`hil.loop.motion` owns the records.
"""

from math import inf, nan
from typing import Any

import numpy as np

from drivers.compiled.compiler import INTEGER, REAL, direct, helper, record
from drivers.compiled.pointed import address_of, call
from hil.trajectory.override import OVERRIDE, go_on, is_full, is_resting, looked_ahead, time_at
from hil.trajectory.path import SAMPLE
from hil.trajectory.stopping import slow

MOTION = np.dtype(
    [
        ("function", "<i8"),
        ("context", "<i8"),
        ("duration", "<f8"),
        ("stopped", "<i8"),
        ("then_function", "<i8"),
        ("then_context", "<i8"),
    ]
)
"""The trajectory's function and what it works on, its length in s (inf without an end), the tick at which a
stop from less than full speed came to rest, and the same two of what comes next, 0 where nothing does."""
ENDED, OVERDUE = 1, 2
NO_STOP, SLOWS = -2, -1
"""`stopped` without such a stop, and until it has come to rest."""


@helper
def along(function: int, context: int, t: float, sigma: float, dsigma: float, sample: Any) -> int:
    """Fill the sample of a path at its time t (s), which runs at sigma and its rate; return the status."""
    status: int = call(function, (context, t, address_of(sample)))
    if sigma != 1.0 or dsigma != 0.0:
        slow(sample, sigma, dsigma)
    return status


@helper
def place_reference(override: Any, function: int, context: int, tick: int, sample: Any) -> int:
    """Fill the sample with where the platform should be at a tick; return the path's status."""
    t = time_at(override, tick)
    return along(function, context, t, override.sigma, override.dsigma, sample)


@helper
def advance(motion: Any, override: Any, tick: int) -> None:
    """Go on to a tick."""
    go_on(override, tick)
    if motion.stopped == SLOWS and is_resting(override):
        motion.stopped = tick


@helper
def ended(motion: Any, override: Any, tick: int) -> bool:
    """Whether the present trajectory has ended."""
    if motion.stopped != NO_STOP:
        return bool(0 <= motion.stopped <= tick)
    return bool(time_at(override, tick) >= motion.duration)


@helper
def overdue(motion: Any, override: Any, tick: int, patience: float) -> bool:
    """Whether the present trajectory ended longer than `patience` (s) ago."""
    if motion.stopped != NO_STOP:
        late = (tick - motion.stopped) * override.period > patience
        return bool(late and ended(motion, override, tick))
    return bool(time_at(override, tick) > motion.duration + patience)


@helper
def ticks_left(motion: Any, override: Any, tick: int) -> int:
    """In how many ticks the present trajectory will have ended at full speed; 0 where it has.

    It has an end. By path time: a hold on the way puts the end off.
    """
    ticks = max(int((motion.duration - time_at(override, tick)) / override.period), 0)
    while time_at(override, tick + ticks) < motion.duration:
        ticks += 1
    return ticks


@helper
def ahead(motion: Any, override: Any, tick: int, s: float, sample: Any) -> tuple[int, float]:
    """Fill the sample with where the platform should be `s` seconds after a tick.

    Returns the status, and that time along what comes next: nan unless that is expected to have begun.
    """
    function, context = motion.function, motion.context
    if not is_full(override):
        t, sigma, dsigma = looked_ahead(override, tick, s)
        return along(function, context, t, sigma, dsigma, sample), nan
    if motion.then_function != 0 and motion.duration < inf and not ended(motion, override, tick):
        t = s - ticks_left(motion, override, tick) * override.period
        if t >= 0.0:
            return along(motion.then_function, motion.then_context, t, 1.0, 0.0, sample), t
    return along(function, context, time_at(override, tick) + s, 1.0, 0.0, sample), nan


@direct(record(MOTION), record(OVERRIDE), INTEGER, record(SAMPLE))
def sample_at(motion: Any, override: Any, tick: int, sample: Any) -> int:
    """Fill the sample of a tick; return the status."""
    return place_reference(override, motion.function, motion.context, tick, sample)


@direct(record(MOTION), record(OVERRIDE), INTEGER, REAL)
def end(motion: Any, override: Any, tick: int, patience: float) -> int:
    """Return 0 before the trajectory has ended, then ENDED, and OVERDUE after `patience` (s) more."""
    if overdue(motion, override, tick, patience):
        return OVERDUE
    return ENDED if ended(motion, override, tick) else 0


advance_to = direct(record(MOTION), record(OVERRIDE), INTEGER)(advance)
"""advance for Python."""
