"""A family's decoder, and the turns that its drives have forgotten added to what it reads, compiled."""

from typing import Any

import numpy as np

from drivers.compiled.compiler import INTEGER, helper, record
from drivers.compiled.pointed import address_of, call, pointed
from drivers.signals import LEGS
from drivers.tick_columns import TICK, part
from hil.loop.homing import HOMING, SILENT_TICKS, leaps

_TICK = record(TICK, "tick", *part("measurement"))


@helper
def _decides(h: Any, leg: int, last: Any, tick: Any) -> bool:
    """Tell whether the turn of a leg is to be found, or may be lost: `Homing.correct` decides it."""
    if h.known[leg]:
        ticks = tick.tick - last.tick + last.age[leg] - tick.age[leg]
        expected_m = h.raw[leg] + last.rate[leg] * ticks * h.period_s
        if tick.age[leg] > SILENT_TICKS or leaps(tick.length[leg], expected_m, h.step_m[leg]):
            return True
    return bool(tick.age[leg] <= 1 and not h.lost[leg] and (not h.known[leg] or h.wrong[leg]))


@pointed(record(HOMING), INTEGER, INTEGER, INTEGER, _TICK, _TICK)
def decode(h: Any, frames: int, count: int, since_ns: int, last: Any, tick: Any) -> int:
    """Decode as the family does, which has to see the lengths that the drives report, and add the turns."""
    believed = last.length.copy()
    last.length[:] = h.raw
    tick_at = address_of(tick)
    status: Any = np.int64(call(h.decode, (h.codec, frames, count, since_ns, address_of(last), tick_at)))
    last.length[:] = believed
    if status < 0:
        return int(status)
    for leg in range(LEGS):
        if _decides(h, leg, last, tick):
            news: Any = np.int64(call(h.correct, (tick_at,)))
            return int(news if news < 0 else max(status, news))
    h.opened |= not h.braked
    h.raw[:] = tick.length
    for leg in range(LEGS):
        tick.length[leg] += h.added[leg]
    return int(status)
