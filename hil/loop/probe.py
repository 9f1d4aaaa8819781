"""The probe: the force by which a leg that safety suspects is pushed, to see whether its reading moves.

A stage between the law and the limits: safety counts for how long a leg has been suspected, the force
follows from that, and the limits hold for the sum.
"""

from math import copysign
from typing import Any

from drivers.compiled.compiler import helper
from drivers.signals import LEGS


@helper
def fill_probe(tick: Any, last: Any, limits: Any, memory: Any) -> None:
    """Fill probe_force, (6,) N, > 0 extends, from the last tick's on: it changes by no more than it turns.

    limits, memory: records of `hil.safety.kernels`.
    """
    for i in range(LEGS):
        rise, ticks = limits.rise_ticks, limits.push_ticks
        force = push_of(memory.push[i], ticks, limits.push_N[i], limits.sticks != 0, rise)
        most = 2.0 * limits.push_N[i] / max(ticks - 2 * (rise - 1), 1)
        if limits.sticks != 0 and memory.push[i] != 0:
            most = max(most, 2.0 * limits.push_N[i] / (2 * rise - 1))
        was = last.probe_force[i]
        tick.probe_force[i] = min(max(force, was - most), was + most)


@helper
def push_of(so_far: int, ticks: int, force: float, sticks: bool, rise: int) -> float:
    """Return the force that is added to a leg, N; 0 where it is not pushed.

    For `ticks` its first way, then the other: along straight lines, where it sticks within `rise` ticks to
    the whole force and as steeply to the other one; 1: at once.
    """
    if so_far == 0:
        return 0.0
    first, k = copysign(force, so_far), abs(so_far)
    if sticks:
        whole = 2 * rise - 1
        return first * min(k / rise, 1.0, max(whole - 2 * (k - ticks), -whole) / whole)
    return first * min(2 * k, ticks, max(3 * ticks - 2 * k, -ticks)) / ticks
