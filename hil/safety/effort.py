"""Limits on the forces: size, change per tick, change within 250 ms.

Rule of the room: see `hil.safety`. Each limit works in place on tau (6,) N and tells whether it acted. All
three allow the last force sent, so that any order of them leaves something to send.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hil.compile_cache import helper

Array = NDArray[np.float64]


@helper
def clamp(tau: Array, low: Array, high: Array) -> bool:
    """Bring tau (6,) between low and high (6,), in place; tell whether that changed it."""
    acted = False
    for i in range(6):
        if tau[i] > high[i]:
            tau[i] = high[i]
            acted = True
        elif tau[i] < low[i]:
            tau[i] = low[i]
            acted = True
    return acted


@helper
def limit_force(tau: Array, force: float) -> bool:
    """Keep every |tau| <= force (N)."""
    bound = np.full_like(tau, force)
    return clamp(tau, -bound, bound)


@helper
def limit_step(tau: Array, last: Array, step: float) -> bool:
    """Keep every tau within `step` (N) of the last one sent, last (6,) N."""
    return clamp(tau, last - step, last + step)


@helper
def window_extremes(history: Array, count: int) -> tuple[Array, Array]:
    """Smallest and largest force (6,) N of each leg in the first `count` >= 1 rows of history (n, 6)."""
    low, high = history[0].copy(), history[0].copy()
    for k in range(count):
        for i in range(6):
            low[i] = min(low[i], history[k, i])
            high[i] = max(high[i], history[k, i])
    return low, high


@helper
def limit_window(tau: Array, low: Array, high: Array, window: float) -> bool:
    """Keep every tau within `window` (N) of all forces between low and high (6,) N, those of the window."""
    return clamp(tau, high - window, low + window)
