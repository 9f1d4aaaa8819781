"""Samples as the page reads them: thinned without hiding a peak, 32 bit floats in base 64."""

import base64

import numpy as np
from numpy.typing import ArrayLike

from drivers.arrays import Array

BINS = 2000
"""More than a screen has pixels across."""


def thin(t: Array, series: list[Array], bins: int = BINS) -> tuple[Array, list[Array]]:
    """Return at most two samples a bin of each series: its least and its largest value there.

    t (n,) s; each of series (n,). Up to 2 bins samples come back as they are. A bin has two instants, its
    first and its middle sample's; the least comes first where the series rises across the bin. nan counts
    only where a whole bin is nan.
    """
    n = len(t)
    if n <= 2 * bins:
        return t, series
    starts = np.linspace(0, n, bins + 1).astype(np.int64)
    first, last = starts[:-1], starts[1:] - 1
    x = np.stack((t[first], t[(first + last + 1) // 2]), axis=1).ravel()
    thinned = []
    for y in series:
        low, high = np.fmin.reduceat(y, first), np.fmax.reduceat(y, first)
        falls = y[first] > y[last]
        pair = np.where(falls[:, None], np.stack((high, low), axis=1), np.stack((low, high), axis=1))
        thinned.append(pair.ravel())
    return x, thinned


def packed(values: ArrayLike) -> str:
    """Any array as little-endian float32 in base 64, row by row; what is not finite becomes nan."""
    with np.errstate(over="ignore", invalid="ignore"):
        narrow = np.asarray(values, np.float64).astype("<f4").ravel()
    narrow[~np.isfinite(narrow)] = np.nan
    return base64.b64encode(narrow.tobytes()).decode("ascii")
