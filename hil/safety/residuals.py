"""Rules on encoders from one reading to the next: what contradicts what, and by how much.

Time. All drives latch at one SYNC. Where that comes later than the clock says, every length is off by its
rate times the same delay: what all legs agree on is time, what one leg says alone is not. Where too few legs
are heard or move to bear witness, what none contradicts may be one.

Length against rate: an encoder that jumps, and one that slips or whose rate is dead. With T between two
latches and an acceleration that varies within a range a over it,

    |q1 - q0 - T (dq0 + dq1) / 2| <= a T^2 / 8 + 2 noise of a length + T noise of a rate.

A brake that closes on a leg that still creeps takes no more than REST T / 2 beside that. What stops a moving
leg within a tick makes its rate leap, and a gap of up to half of that times T.

Rate against force and model: a rate that leaps farther than forces can make it. The acceleration of a leg
changes by what the forces sent change, times the mobility of the model, and by the stated disturbance, from
one end of its range to the other:

    |dq2 - dq1 - T ddq| <= T (2 disturbance + sum over legs of mobility |change of force|) + noise,

ddq the mean acceleration over the tick before. One leg alone beyond it is the encoder, or a force along that
leg; more than one is a load.

Rates that are slopes of lengths. The slope at the end of the parabola through three lengths, T0 and then T1 s
apart, is exact at a constant acceleration. One that varies within a range a makes it wrong by the integral of
Peano's kernel,

    |slope - dq| <= a T1 / (2 (1 + r)),     r = T1 / (T1 + T0):

a third of a period where both steps are one. A latch that is d s later than the clock says makes a slope
wrong by a share of the rate, 3 d / (2 T) for equal steps, the same in all legs, and so the next two. A length
that jumps by J makes its own slope leap by 3 J / (2 T), and the gap between length and slope is J / 4 alone.
So a jump shows as a leap. Later ticks show more of it, but by then the law has answered it with a force that
explains as much. A latch that is late is a jump by its way, and one back: its leaps follow each other as 1.5,
-5, 6, -3 and 0.5 times rate d / T.

A reading that stands still while its leg must move: a frozen encoder, or a brake that is shut. A leg whose
reading stays within its noise is suspected once it, or another leg, is farther from the reference than when
that began. A load may leave a leg still by chance, and friction may hold it. So it is pushed: without
friction one way and then the other, as load and law may change while the first lasts, by a force that rises
and falls, which nobody feels; with friction as `hil.loop.probe` has it, at once, or as slowly as a light
platform needs that is not to leap when it comes free. A reading that does not move under that is not that
of a free leg. What a leg does that was pushed makes no other one suspect until it has settled: pushes would
go from leg to leg.
"""

from math import copysign, inf, isnan

from drivers.arrays import Array, Ints
from drivers.compiled.compiler import helper
from hil.safety.motion import REST_m_s

WITNESSES = 3
"""Legs that must show a delay, and agree on it, before it counts as one."""
WINDOW_S = 0.05
"""Time constant of the sum in which a slow slip shows."""
LONG = 1.5
"""So many periods make a tick a long one."""
SLOW = 4.0
"""So many of a tick's bounds of the acceleration may add up in that sum: their parts of one sign cancel."""
TIME_LEAPS = 6.0
"""Of a rate, times the periods by which one latch is late, in the largest of the leaps that this makes."""
SHOWS_AS_LEAP = 1.5
"""Of a length that jumps, over a period, in the leap of its slope."""
SHOWS_AS_GAP = 0.25
"""The same in the gap between length and slope."""
SUSPECT = 10.0
"""So many times the noise of a length make the deviation of a leg count as motion."""
MOVED = 3.0
"""So many times the noise a free leg moves while it is pushed."""
SETTLES_S = 0.2
"""Until a leg that was pushed follows its reference again."""


@helper
def shared_delay(gap: Array, rate: Array, tolerance: Array) -> tuple[float, bool]:
    """Return the delay, s, that explains the gaps best, and whether enough legs bear witness of it.

    It minimises sum |gap_i - rate_i delay|: the minimum is where one leg is explained whole. gap (6,) m,
    rate (6,) m/s, tolerance (6,) m; nan in gap: the leg has no say. Without witnesses it is 0.
    """
    best, least = 0.0, inf
    for i in range(6):
        if rate[i] != 0.0 and not isnan(gap[i]):
            delay = gap[i] / rate[i]
            left = 0.0
            for j in range(6):
                if not isnan(gap[j]):
                    left += abs(gap[j] - rate[j] * delay)
            if left < least:
                best, least = delay, left
    witnesses = 0
    for i in range(6):
        shown = abs(rate[i] * best) > tolerance[i]
        witnesses += shown and abs(gap[i] - rate[i] * best) <= tolerance[i]
    if witnesses >= WITNESSES:
        return best, True
    return 0.0, False


@helper
def explained(i: int, gap: Array, rate: Array, tolerance: Array, say: Array) -> bool:
    """Tell whether some delay explains the gap of leg i, and that of each leg that has a say, nan: none.

    gap (6,) m, rate (6,) m/s, tolerance (6,) m, say (6,) m: the gaps of those that have one.
    """
    for j in range(6):
        apart = abs(gap[i] * rate[j] - say[j] * rate[i])
        if apart > tolerance[i] * abs(rate[j]) + tolerance[j] * abs(rate[i]):
            return False
    return True


@helper
def beside(gap: float, leap: float, T: float) -> float:
    """Return a gap, m, less the largest share of it that a leap of the rate, m/s, within T s explains."""
    return copysign(max(abs(gap) - 0.5 * T * abs(leap), 0.0), gap)


@helper
def gap_bound(noise: float, rate_noise: float, acceleration: float, T: float) -> float:
    """Return the largest gap, m, of an encoder that works.

    noise m and rate_noise m/s of one reading; acceleration m/s^2: the range over which it may vary in T s.
    """
    return 2.0 * noise + T * rate_noise + 0.125 * acceleration * T * T + 0.5 * REST_m_s * T


@helper
def slip_bound(
    noise: float, rate_noise: float, acceleration: float, T: float, share: float, travel: float
) -> float:
    """Return the largest sum of gaps, m, of an encoder that works.

    As `gap_bound`; share: of a rate that is wrong; travel: sum of |rate| T, remembered as the gaps are, m.
    """
    window = max(WINDOW_S, T)
    bound = gap_bound(noise, rate_noise, SLOW * acceleration, T)
    return bound + (window - T) * rate_noise + share * travel


@helper
def excused(left: float, total: float, calm: float, T: float, period: float) -> float:
    """Return the part of a sum of gaps, m, that does not count against the encoder from the next tick on.

    A stall makes a tick of T s long, and what its length explains stays in the sum: `total`, m, as far as
    that is beyond `calm`, the bound of a tick of no length, for the next one may be short. left: of what was
    excused before, m. Calm stalls excuse nothing.
    """
    return max(left, abs(total) - calm) if LONG * period < T else left


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
def leap_bound(rate_noise: float, acceleration: float, T: float, T_was: float) -> float:
    """Return the largest leap, m/s, that forces explain within T s.

    acceleration m/s^2: the range of that of the leg; T_was s: over which the last acceleration was the mean;
    rate_noise m/s of one reading.
    """
    return T * acceleration + 2.0 * rate_noise * (1.0 + T / T_was)


@helper
def sole(excess: Array) -> int:
    """Return the only leg whose share of its bound is above 1; -1 for no leg or several."""
    found = -1
    for i in range(6):
        if excess[i] > 1.0:
            if found >= 0:
                return -1
            found = i
    return found


@helper
def lag_of(T: float, T_was: float) -> float:
    """Return by how much, s, times the range of the acceleration a slope may be wrong.

    T s: its last step; T_was s: the one before, 0: unknown, then the longest that any leaves.
    """
    return 0.5 * T * (T + T_was) / (2.0 * T + T_was) if T_was > 0.0 else 0.5 * T


@helper
def lag_of_leap(lag: float, lag_was: float, T: float, T_was: float) -> float:
    """Return the same for how far a slope leaps: it is made of three, the first one taken like the second."""
    return lag + lag_was * (1.0 + 2.0 * T / T_was)


@helper
def is_time(leg: int, leaps: Array, rates: Array, bounds: Array, latest: float) -> bool:
    """Tell whether a latch that is late explains that the rate of a leg leaps, beside those of the others.

    leaps (6,) m/s, nan: unknown; rates (6,) m/s, before; bounds (6,) m/s of the leaps; latest: periods.
    """
    if isnan(leaps[leg]) or abs(leaps[leg]) > bounds[leg] + TIME_LEAPS * latest * abs(rates[leg]):
        return False
    return explained(leg, leaps, rates, bounds, leaps)


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
