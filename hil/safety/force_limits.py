"""The limits of the leg forces: size, change per tick and within 250 ms.

All three allow the last force sent, so in any order they leave a force that may be sent.
"""

from typing import Any

from drivers.arrays import Array
from drivers.compiled.compiler import helper
from drivers.signals import LEGS, Fault, Warn
from hil.safety.signals import all_finite


@helper
def clamp(tau: Array, i: int, low: float, high: float) -> bool:
    """Limit tau[i], N, to low .. high, in place; True if that changed it."""
    if tau[i] > high:
        tau[i] = high
        return True
    if tau[i] < low:
        tau[i] = low
        return True
    return False


BLOCK = 16
"""Rows per block of the window, for which extremes are stored: a new force costs 16 rows, not the whole
window."""


@helper
def widen(rows: Array, low: Array, high: Array) -> None:
    """Widen the ranges low .. high (6,) so that they include all rows (n, 6)."""
    for k in range(rows.shape[0]):
        for i in range(6):
            low[i] = min(low[i], rows[k, i])
            high[i] = max(high[i], rows[k, i])


@helper
def remember(tau: Array, row: int, window: Array, rows: int) -> None:
    """Store tau (6,) N in a row of the window, and update smallest and largest force of its block.

    window: the forces sent, (rows, 6) N, then the smallest and then the largest of each block of BLOCK rows.
    """
    window[row] = tau
    low = rows + row // BLOCK
    high = low + (window.shape[0] - rows) // 2
    window[low] = window[high] = tau
    first = row // BLOCK * BLOCK
    widen(window[first : min(first + BLOCK, rows)], window[low], window[high])


@helper
def window_extremes(window: Array, rows: int) -> tuple[Array, Array]:
    """Smallest and largest force (6,) N of each leg in the window of sent forces, from its blocks."""
    low, high = window[rows].copy(), window[rows].copy()
    widen(window[rows:], low, high)
    return low, high


@helper
def limit_effort(tick: Any, limits: Any, memory: Any, window: Array) -> tuple[int, int]:
    """Fill tau with the limited sum of tau_asked and probe_force; returns fault bits and warning bits.

    window: see `remember`, a ring of the forces sent, its newest row `memory.newest`; receives the forces
    held during skipped periods, and the new ones. If a requested force is not finite, all become 0,
    with fault LAW.
    """
    faults = warnings = 0
    tau = tick.tau
    tau[:] = tick.tau_asked
    if not all_finite(tau):
        faults = Fault.LAW.value
        tau[:] = 0.0
    for i in range(LEGS):
        tau[i] += tick.probe_force[i]
    rows, newest = limits.window_ticks, memory.newest
    last = window[newest].copy()
    for _ in range(min(tick.skipped, rows)):
        newest = (newest + 1) % rows
        remember(last, newest, window, rows)
    low, high = window_extremes(window, rows)
    most, step, reach = limits.force_N, limits.force_step_N, limits.force_window_N
    for i in range(LEGS):
        if clamp(tau, i, -most, most):
            warnings |= Warn.FORCE_LIMIT.value
        if clamp(tau, i, last[i] - step, last[i] + step):
            warnings |= Warn.FORCE_STEP.value
        if clamp(tau, i, high[i] - reach, low[i] + reach):
            warnings |= Warn.FORCE_WINDOW.value
    memory.newest = (newest + 1) % rows
    remember(tau, memory.newest, window, rows)
    return faults, warnings
