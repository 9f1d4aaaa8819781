"""Limits on the forces: size, change per tick, change within 250 ms.

Each limit works in place on tau (6,) N and tells whether it acted. All three allow the last force sent, so
that any order of them leaves something to send.
"""

from drivers.arrays import Array
from drivers.compiled.compiler import helper


@helper
def clamp(tau: Array, i: int, low: float, high: float) -> bool:
    """Bring tau[i] between low and high, in place; tell whether that changed it."""
    if tau[i] > high:
        tau[i] = high
        return True
    if tau[i] < low:
        tau[i] = low
        return True
    return False


@helper
def limit_force(tau: Array, force: float) -> bool:
    """Keep every |tau| <= force (N)."""
    acted = False
    for i in range(6):
        acted |= clamp(tau, i, -force, force)
    return acted


@helper
def limit_step(tau: Array, last: Array, step: float) -> bool:
    """Keep every tau within `step` (N) of the last one sent, last (6,) N."""
    acted = False
    for i in range(6):
        acted |= clamp(tau, i, last[i] - step, last[i] + step)
    return acted


BLOCK = 16
"""Rows of the window whose extremes are kept together: a new force then costs 16 rows and not the window."""


@helper
def widen(rows: Array, low: Array, high: Array) -> None:
    """Let low and high (6,) take in all rows (n, 6)."""
    for k in range(rows.shape[0]):
        for i in range(6):
            low[i] = min(low[i], rows[k, i])
            high[i] = max(high[i], rows[k, i])


@helper
def remember(tau: Array, row: int, history: Array, lows: Array, highs: Array) -> None:
    """Put tau (6,) N into a row of history (n, 6) and mend the extremes of its block, (ceil(n/BLOCK), 6)."""
    history[row] = tau
    block = row // BLOCK
    lows[block] = tau
    highs[block] = tau
    first = block * BLOCK
    widen(history[first : first + BLOCK], lows[block], highs[block])


@helper
def window_extremes(lows: Array, highs: Array) -> tuple[Array, Array]:
    """Smallest and largest force (6,) N of each leg in the window, from those of its blocks."""
    low, high = lows[0].copy(), highs[0].copy()
    widen(lows, low, high)
    widen(highs, low, high)
    return low, high


@helper
def limit_window(tau: Array, low: Array, high: Array, window: float) -> bool:
    """Keep every tau within `window` (N) of all forces between low and high (6,) N, those of the window."""
    acted = False
    for i in range(6):
        acted |= clamp(tau, i, high[i] - window, low[i] + window)
    return acted
