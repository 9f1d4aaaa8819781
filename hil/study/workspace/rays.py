"""Rays, paths out of the workspace: followed in small steps to the first that fails, then bisected."""

from collections.abc import Callable

import numpy as np

from drivers.arrays import Array, Ints
from hil.study.workspace.limits import Surveyor

Paths = Callable[[Array, Ints], tuple[Array, Array]]
"""(t (n,), which (n,)) -> poses P (n, 3), R (n, 3, 3) or (3, 3): path which[k] at t[k]; t = 0 is inside."""
FREE = -1
"""Kind of a path that ends without having met a limit."""


def levels(below: float, above: float, count: int) -> Array:
    """Return (2 count + 1,) from -below to above, `count` even steps on either side of zero."""
    return np.concatenate([-below * np.arange(count, 0, -1), above * np.arange(count + 1)]) / count


def first_exit(surveyor: Surveyor, paths: Paths, count: int, step: float, end: float) -> tuple[Array, Ints]:
    """Return for each path the last t inside, at most ``end``, and the kind of limit met there.

    What lies between two steps is not looked at: a gap shorter than ``step`` may be missed.
    """
    low = np.zeros(count)
    high = np.full(count, np.nan)
    going = np.arange(count)
    while len(going):
        t = np.minimum(low[going] + step, end)
        good = surveyor.inside(*paths(t, going))
        high[going[~good]] = t[~good]
        low[going[good]] = t[good]
        going = going[good & (t < end)]
    kinds: Ints = np.full(count, FREE)
    met = np.flatnonzero(~np.isnan(high))
    if len(met):
        low[met], kinds[met] = surveyor.leave(lambda t: paths(t, met), low[met], high[met])
    return low, kinds
