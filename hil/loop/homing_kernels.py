"""The drive family's compiled decoder, extended by the motor turns that its drives lose at power-off."""

from typing import Any

import numpy as np

from drivers.compiled.compiler import INTEGER, helper, record
from drivers.compiled.pointed import address_of, call, pointed
from drivers.signals import LEGS
from drivers.tick_columns import TICK, part
from hil.loop.homing import ENDS, HOMING, LOST, MOVED, SILENT_TICKS

_TICK = record(TICK, "tick", *part("measurement"))


@helper
def find(h: Any, leg: int, raw: float, last: Any, tick: Any) -> None:
    """Find a motor's lost turns if they are unknown or may have changed; raw: reported length, m."""
    age, step = tick.age[leg], h.step_m[leg]
    expected = h.raw[leg] + last.rate[leg] * (tick.tick - last.tick + last.age[leg] - age) * h.period_s
    if h.known[leg] and (age > SILENT_TICKS or abs(raw - expected) >= 0.5 * step):
        h.known[leg], h.there[leg] = 0, last.length[leg]
        if not h.braked:
            h.lost[leg], h.wrong[leg] = 1, LOST
    if age > 1 or h.lost[leg] or (h.known[leg] and not h.wrong[leg]):
        return
    h.known[leg] = 1
    added = step * np.rint((h.there[leg] - raw) / step) + 0.0
    h.added[leg] = added
    if not abs(raw + added - h.there[leg]) <= h.limit_m[leg]:  # nan, too
        h.wrong[leg] = MOVED
    elif not (h.low[leg] + added <= h.shortest and h.longest <= h.high[leg] + added):
        h.wrong[leg] = ENDS
    else:
        h.wrong[leg] = 0


@helper
def all_known(h: Any) -> bool:
    """True while the lost turns of all motors are known and no leg has a problem."""
    for leg in range(LEGS):  # noqa: SIM110 - compiled
        if h.known[leg] == 0 or h.wrong[leg] != 0:
            return False
    return True


@pointed(record(HOMING), INTEGER, INTEGER, INTEGER, _TICK, _TICK)
def decode(h: Any, frames: int, count: int, since_ns: int, last: Any, tick: Any) -> int:
    """Decode with the family's decoder, on lengths as the drives report them; then add the lost turns."""
    believed, known = last.length.copy(), all_known(h)
    last.length[:] = h.raw
    tick_at = address_of(tick)
    status: Any = np.int64(call(h.decode, (h.codec, frames, count, since_ns, address_of(last), tick_at)))
    last.length[:] = believed
    h.opened |= not h.braked
    for leg in range(LEGS):
        find(h, leg, tick.length[leg], last, tick)
    h.raw[:] = tick.length
    for leg in range(LEGS):
        tick.length[leg] += h.added[leg]
    return int(max(status, np.int64(all_known(h) != known)))
