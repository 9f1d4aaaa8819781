"""What the compiled pass expects of a motion, tick by tick."""

from __future__ import annotations

from math import isnan
from typing import Any

import numpy as np

from drivers.compiled.compiler import INTEGER, REAL, kernel, record
from hil.loop.motion import MOTION, Motion, ticks_left
from hil.loop.motion import ahead as ahead_of
from hil.trajectory.override import OVERRIDE
from hil.trajectory.path import SAMPLE, PoseSample, of_record

_ticks_left = kernel(record(MOTION), record(OVERRIDE), INTEGER)(ticks_left)
_ahead = kernel(record(MOTION), record(OVERRIDE), INTEGER, REAL, record(SAMPLE))(ahead_of)


def before(motion: Motion, tick: int, path: Any) -> float | None:
    """Return the time before a path begins that comes next, s; None where nobody knows when it does."""
    if motion.then is not path or not motion.override.full:
        return None
    return float(-_ticks_left(motion.record, motion.override.record, tick) * motion.override.record["period"])


def ahead(motion: Motion, tick: int, s: float) -> tuple[PoseSample, float | None]:
    """Return where the platform should be `s` seconds after a tick, and that time along what comes next."""
    into = np.zeros((), SAMPLE)
    status, along = _ahead(motion.record, motion.override.record, tick, s, into)
    assert status == 0
    return of_record(into), None if isnan(along) else along
