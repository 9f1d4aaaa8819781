"""Sine and cosine from +, -, *, / only.

No call into libm. The C library selects its sine by CPU at load time, and the last bit differs between the
variants. A reference built on it would not replay bit for bit. Additions, products and quotients round alike
on all machines.
"""

import math

import numpy as np

from drivers.compiled.compiler import helper

# pi/2 as a sum whose first two terms have 31 bits: n * term is exact for n < 2^22
_HALF_PI_1 = float.fromhex("0x1.921fb544p+0")
_HALF_PI_2 = float.fromhex("0x1.0b4611a4p-34")
_HALF_PI_3 = float.fromhex("0x1.13198a2e03707p-65")
_TWO_OVER_PI = 2.0 / math.pi


@helper
def _sin_small(x: float) -> float:
    """Taylor series to x^17 for |x| <= pi/4; the first omitted term is below 1e-19."""
    z = x * x
    series = 1.0 / 355687428096000.0
    series = series * z - 1.0 / 1307674368000.0
    series = series * z + 1.0 / 6227020800.0
    series = series * z - 1.0 / 39916800.0
    series = series * z + 1.0 / 362880.0
    series = series * z - 1.0 / 5040.0
    series = series * z + 1.0 / 120.0
    series = series * z - 1.0 / 6.0
    return x + x * (z * series)


@helper
def _cos_small(x: float) -> float:
    """Taylor series to x^18 for |x| <= pi/4."""
    z = x * x
    series = -1.0 / 6402373705728000.0
    series = series * z + 1.0 / 20922789888000.0
    series = series * z - 1.0 / 87178291200.0
    series = series * z + 1.0 / 479001600.0
    series = series * z - 1.0 / 3628800.0
    series = series * z + 1.0 / 40320.0
    series = series * z - 1.0 / 720.0
    series = series * z + 1.0 / 24.0
    return 1.0 - (0.5 * z - z * z * series)


@helper
def sincos(x: float) -> tuple[float, float]:
    """sin(x) and cos(x), x in rad, |x| <= 1e6; error <= 1e-15.

    x = n pi/2 + r with |r| <= pi/4 (Cody and Waite, 1980), then the Taylor series of r.
    """
    n = np.floor(x * _TWO_OVER_PI + 0.5)
    r = ((x - n * _HALF_PI_1) - n * _HALF_PI_2) - n * _HALF_PI_3
    s = _sin_small(r)
    c = _cos_small(r)
    quadrant = n - 4.0 * np.floor(0.25 * n)
    if quadrant == 0.0:
        return s, c
    if quadrant == 1.0:
        return c, -s
    if quadrant == 2.0:
        return -s, -c
    return -c, s
