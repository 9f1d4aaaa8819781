"""Rule on a reading that stands still while its leg must move: a frozen encoder, or a brake that is shut.

A leg whose reading stays within its noise is suspected once it, or another leg, is farther from the
reference than when that began. A load may leave a leg still by chance, and friction may hold it. So it is
pushed, one way and then the other, as load and law may change while the first lasts: where there is friction
by more than it can hold, at once, or as slowly as a light platform needs that is not to leap when it comes
free; where there is none by a force that rises and falls, which nobody feels. A
reading that does not move under that is not that of a free leg. What a leg does that was pushed makes no
other one suspect until it has settled: pushes would go from leg to leg.
"""

import math

from drivers.arrays import Array, Ints
from drivers.compiled.compiler import helper

SUSPECT = 10.0
"""So many times the noise of a length make the deviation of a leg count as motion."""
MOVED = 3.0
"""So many times the noise a free leg moves while it is pushed."""
SETTLES_S = 0.2
"""Until a leg that was pushed follows its reference again."""


@helper
def stands(length: float, rate: float, anchor: float, noise: float, rate_noise: float) -> bool:
    """Tell whether a reading is where it was, and its rate zero, but for noise. m, m/s."""
    return abs(length - anchor) <= noise and abs(rate) <= rate_noise


@helper
def strayed(deviation: Array, began: Array, age: Ints) -> float:
    """Return by how much a leg heard in this tick strayed from the reference since then, the farthest, m.

    deviation (6,) m: length less reference; began (6,) m: what it was when a reading began to stand still.
    """
    farthest = 0.0
    for j in range(6):
        if age[j] == 0:
            farthest = max(farthest, abs(deviation[j] - began[j]))
    return farthest


@helper
def pushed(so_far: int, deviation: float) -> int:
    """Return the ticks of a push, < 0 where it retracts the leg: towards its reference, from the first on."""
    if so_far > 0:
        return so_far + 1
    if so_far < 0:
        return so_far - 1
    return -1 if deviation > 0.0 else 1


@helper
def push_of(so_far: int, ticks: int, force: float, sticks: bool, rise: int) -> float:
    """Return what is added to a leg, N; 0: no push.

    For `ticks` its first way, then the other: along straight lines, where it sticks within `rise` ticks to
    the whole force and as steeply to the other one; 1: at once.
    """
    if so_far == 0:
        return 0.0
    first, k = math.copysign(force, so_far), abs(so_far)
    if sticks:
        whole = 2 * rise - 1
        return first * min(k / rise, 1.0, max(whole - 2 * (k - ticks), -whole) / whole)
    return first * min(2 * k, ticks, max(3 * ticks - 2 * k, -ticks)) / ticks


@helper
def eased(last: float, force: float, most: float) -> float:
    """Return what is added to a leg, N: the force, or what is nearest to it within `most` of the last one."""
    return min(max(force, last - most), last + most)


@helper
def held_fast(so_far: int, ticks: int) -> bool:
    """Tell whether a leg has not moved under both pushes of so many ticks."""
    return abs(so_far) > 2 * ticks
