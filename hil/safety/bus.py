"""Rules on the bus: off, or refusing frames for too long.

Rule of the room: see `hil.safety`. A full queue and a dead bus look the same; only time tells them apart.
"""

from __future__ import annotations

SEND_FAULT_TICKS = 5
"""Ticks in a row with a refused frame that make a dead bus."""


def failing_run(run: int, sends_failed: int) -> int:
    """Return the ticks in a row with a refused frame, from their number so far and this tick's failures."""
    return run + 1 if sends_failed > 0 else 0


def bus_down(bus_off: bool, run: int) -> bool:
    """Tell whether the bus is off, or has refused frames in `run` >= SEND_FAULT_TICKS ticks in a row."""
    return bus_off or run >= SEND_FAULT_TICKS
