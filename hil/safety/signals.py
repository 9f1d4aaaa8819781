"""Limits of the checks on drives, bus, frames, the loop's own timing and the recorder.

A full queue and a dead bus look the same; only time tells them apart.
"""

import numpy as np

from drivers.arrays import Array, Ints
from drivers.compiled.compiler import helper
from drivers.signals import Foreign

HISTORY = 32
"""Ticks that a rule remembers, as bits of one integer, the newest lowest."""
IN_A_ROW = 5
"""Ticks in a row with a frame that the bus refused that make a dead bus."""
DEAD_BUS = 8
"""From this many such ticks on, of those remembered, the bus counts as dead, too."""
UNRELIABLE = 8
"""From this many remembered ticks with a refused frame of the drives, the bus counts as unreliable."""
CONTROLLER = int(Foreign.SYNC | Foreign.COMMAND | Foreign.CONFIG)
"""Frames that only a controller sends; a controller does not receive its own frames."""
HARMFUL_STRETCH_NS = 4_000_000
"""A stretch is harmful from this length on: real drives would have ended the run."""
STRETCH_FREE_NS = 500_000_000
"""Total of harmful stretches that is always allowed, in addition to the allowed share of the run."""
DEGRADED_AT = 8
"""Late ticks among those remembered that make a degraded loop."""


@helper
def noted(history: int, happened: bool) -> int:
    """Bits of the last HISTORY ticks (1: something happened), shifted by one, the present tick lowest."""
    return (2 * history + happened) % (1 << HISTORY)


@helper
def ones(history: int) -> int:
    """Number of ticks, of the last HISTORY, in which the event happened: ones in the bits."""
    count = 0
    for k in range(HISTORY):
        count += (history >> k) & 1
    return count


@helper
def bus_down(bus_off: bool, history: int) -> bool:
    """True if the bus is off, or refused frames in IN_A_ROW successive ticks or in DEAD_BUS ticks."""
    row = (1 << IN_A_ROW) - 1
    return bus_off or history & row == row or ones(history) >= DEAD_BUS


@helper
def all_finite(x: Array) -> bool:
    """True if no element of x, of any shape, is infinite or not a number."""
    for value in x.flat:  # noqa: SIM110 - compiled
        if not abs(value) < np.inf:
            return False
    return True


@helper
def stale(age: Ints, limit: int) -> bool:
    """True if a leg's last fresh feedback is at least `limit` ticks old. age (6,) ticks."""
    for ticks in age:  # noqa: SIM110 - compiled
        if ticks >= limit:
            return True
    return False
