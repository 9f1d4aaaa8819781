"""Rule on a leg's rate against force and model: a rate that leaps farther than forces can make it.

From tick to tick the acceleration of a leg changes by what the forces sent change, times the mobility of the
model, and by the stated disturbance, from one end of its range to the other:

    |dq2 - dq1 - T ddq| <= T (2 disturbance + sum over legs of mobility |change of force|) + noise,

ddq the mean acceleration over the tick before. One leg alone beyond it is the encoder, or a force along that
leg; more than one is a load.
"""

from drivers.arrays import Array
from drivers.compiled.compiler import helper


@helper
def acceleration_range(mobility: Array, swing: Array, disturbance: float, i: int) -> float:
    """Return by how much the acceleration of leg i may vary, m/s^2.

    mobility (6, 6) 1/kg: |J M^-1 J^T|; swing (6,) N: largest less smallest of the forces that act by now.
    """
    total = 2.0 * disturbance
    for j in range(6):
        total += mobility[i, j] * swing[j]
    return total


@helper
def leap_of(rate: float, rate_was: float, acceleration: float, T: float) -> float:
    """Return how far a rate is, m/s, from where the last acceleration has brought it within T s."""
    return rate - rate_was - T * acceleration


@helper
def leap_bound(rate_noise: float, acceleration: float, T: float, T_was: float) -> float:
    """Return the largest leap, m/s, that forces explain within T s.

    acceleration m/s^2: the range of that of the leg; T_was s: over which the last acceleration was the mean;
    rate_noise m/s of one reading.
    """
    return T * acceleration + 2.0 * rate_noise * (1.0 + T / T_was)


@helper
def sole(excess: Array) -> int:
    """Return the one leg whose share of its bound is above 1; -1 where there is none, or more than one."""
    found = -1
    for i in range(6):
        if excess[i] > 1.0:
            if found >= 0:
                return -1
            found = i
    return found
