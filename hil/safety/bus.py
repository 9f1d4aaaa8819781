"""Rules on the bus: off, or refusing frames too often.

A full queue and a dead bus look the same; only time tells them apart.
"""

from drivers.compiled.compiler import helper
from hil.safety.history import HISTORY, ones

IN_A_ROW = 5
"""Ticks in a row with a refused frame that make a dead bus."""
OFTEN = 8
"""Ticks with a refused frame among those remembered that make a bus that cannot be relied on."""


@helper
def refusals(history: int, sends_failed: int) -> int:
    """Return the last HISTORY ticks as bits, 1 with a refused frame, newest lowest."""
    return (2 * history + (sends_failed > 0)) % (1 << HISTORY)


@helper
def bus_down(bus_off: bool, history: int) -> bool:
    """Tell whether the bus is off, or has refused frames IN_A_ROW times in a row or OFTEN in all."""
    row = (1 << IN_A_ROW) - 1
    return bus_off or history & row == row or ones(history) >= OFTEN


@helper
def bus_noisy(bus_errors: int, bus_overflow: int, sends_failed: int) -> bool:
    """Tell whether this tick saw error frames, lost receptions or refused frames."""
    return bus_errors > 0 or bus_overflow > 0 or sends_failed > 0
