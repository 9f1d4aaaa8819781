"""Encoder checks from one reading to the next: contradictions of length, rate and force, and their bounds.

Time. All drives sample at one SYNC. If the SYNC comes later than the clock shows, every length is off by its
rate times the same delay. A deviation that all legs agree on is a delay; a deviation of one leg alone is not.
If too few legs report or move for a comparison, a deviation that no leg contradicts may be a delay.

Length against rate: detects an encoder that jumps, slips, or has a dead rate. With T between two samples and
an acceleration that varies within a range a over it,

    |q1 - q0 - T (dq0 + dq1) / 2| <= a T^2 / 8 + 2 noise of a length + T noise of a rate.

A brake that closes on a leg that still creeps adds at most REST T / 2. A stop of a moving leg within a tick
makes its rate leap, and the gap is at most half of that leap times T.

Rate against force and model: detects a rate that leaps farther than forces can explain. The acceleration of a
leg changes with the sent forces, times the mobility of the model, and with the stated disturbance, from one
end of its range to the other:

    |dq2 - dq1 - T ddq| <= T (2 disturbance + sum over legs of mobility |change of force|) + noise,

ddq the mean acceleration over the tick before. If one leg alone violates it, the cause is the encoder, or a
force along that leg; with several legs it is a load.

Rates that are slopes of lengths. The slope at the end of the parabola through three lengths, T0 and then T1 s
apart, is exact at a constant acceleration. If the acceleration varies within a range a, the integral of
Peano's kernel bounds the error,

    |slope - dq| <= a T1 / (2 (1 + r)),     r = T1 / (T1 + T0):

a third of a period for equal steps. A sample d s later than the clock shows makes a slope wrong by a share of
the rate, 3 d / (2 T) for equal steps, the same in all legs, and then the next two slopes. A length that jumps
by J makes its own slope leap by 3 J / (2 T), while the gap between length and slope is only J / 4. So a jump
shows as a leap. Later ticks show more of it, but by then the law has answered with a force that explains as
much. A late sample is a jump by the distance moved, and one back: its leaps are 1.5, -5, 6, -3 and 0.5 times
rate d / T, in this order.

A reading that stands still while its leg must move: a frozen encoder, or a closed brake. A leg whose reading
stays within its noise is suspected as soon as that leg, or another, is farther from the reference than at the
beginning of that standstill. A load may keep a leg still by chance, and friction may hold it. So the leg is
pushed. Without friction it is pushed one way and then the other, as load and law may change meanwhile, by a
force that rises and falls, too gentle to be felt. With friction it is pushed as in `hil.loop.probe`: at once,
or slowly enough that a light platform does not leap when it comes free. A free leg moves under that push. The
motion of a pushed leg makes no other leg suspect until it has settled; otherwise pushes would spread from leg
to leg.
"""

from math import copysign, inf, isnan

from drivers.arrays import Array, Ints
from drivers.compiled.compiler import helper
from hil.safety.motion import REST_m_s

WITNESSES = 3
"""Number of legs that must show a delay, and agree on it, before it counts."""
WINDOW_S = 0.05
"""Time constant, s, of the sum that detects a slow slip."""
LONG = 1.5
"""A tick longer than this number of periods is a long one."""
SLOW = 4.0
"""Number of a tick's acceleration bounds that may add up in that sum: parts of opposite sign cancel."""
TIME_LEAPS = 6.0
"""Largest leap of a rate after one late latch, per rate and per period of delay."""
SHOWS_AS_LEAP = 1.5
"""Leap of the slope per jump of a length, divided by the period."""
SHOWS_AS_GAP = 0.25
"""Gap between length and slope per jump of a length."""
SUSPECT = 10.0
"""A leg has moved if it deviates by more than this multiple of the noise of a length."""
MOVED = 3.0
"""Motion of a free leg under a push, as a multiple of that noise."""
SETTLES_S = 0.2
"""Time, s, until a pushed leg follows its reference again."""


@helper
def shared_delay(gap: Array, rate: Array, tolerance: Array) -> tuple[float, bool]:
    """Delay of the sampling, s, that explains the legs' gaps best, and True if enough legs agree on it.

    It minimises sum |gap_i - rate_i delay|; at the minimum one leg is explained completely. gap (6,) m, rate
    (6,) m/s, tolerance (6,) m; nan in gap: the leg does not count. Without enough legs the delay is 0.
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
    """True if one delay of the sampling explains the gap of leg i and those of all counted legs.

    gap (6,) m, rate (6,) m/s, tolerance (6,) m, say (6,) m: the gaps of counted legs, else nan.
    """
    for j in range(6):
        apart = abs(gap[i] * rate[j] - say[j] * rate[i])
        if apart > tolerance[i] * abs(rate[j]) + tolerance[j] * abs(rate[i]):
            return False
    return True


@helper
def beside(gap: float, leap: float, T: float) -> float:
    """Gap, m, less the largest part of it that a leap of the rate, m/s, within T s can explain."""
    return copysign(max(abs(gap) - 0.5 * T * abs(leap), 0.0), gap)


@helper
def gap_bound(noise: float, rate_noise: float, acceleration: float, T: float) -> float:
    """Largest gap, m, between length change and rate times time that a working encoder shows.

    noise m and rate_noise m/s of one reading; acceleration m/s^2: the range over which it may vary in T s.
    """
    return 2.0 * noise + T * rate_noise + 0.125 * acceleration * T * T + 0.5 * REST_m_s * T


@helper
def slip_bound(
    noise: float, rate_noise: float, acceleration: float, T: float, share: float, travel: float
) -> float:
    """Largest sum of gaps, m, that a working encoder shows; a larger sum means that it slips.

    Arguments as in `gap_bound`; share: relative error of a rate; travel: sum of |rate| T, m, with the same
    forgetting as the gaps.
    """
    window = max(WINDOW_S, T)
    bound = gap_bound(noise, rate_noise, SLOW * acceleration, T)
    return bound + (window - T) * rate_noise + share * travel


@helper
def excused(left: float, total: float, calm: float, T: float, period: float) -> float:
    """Part of a sum of gaps, m, that does not count against the encoder from the next tick on.

    A stall makes a tick of T s long, and the gap that this length explains stays in the sum. The excused part
    is `total`, m, beyond `calm`, the bound for a tick of zero length, as the next tick may be short. left:
    part excused before, m. A stall without such a gap excuses nothing.
    """
    return max(left, abs(total) - calm) if LONG * period < T else left


@helper
def acceleration_range(mobility: Array, swing: Array, disturbance: float, i: int) -> float:
    """Range of the acceleration of leg i, m/s^2, that forces and a disturbance (m/s^2) can cause.

    mobility (6, 6) 1/kg: |J M^-1 J^T|; swing (6,) N: largest less smallest of the forces that act by now.
    """
    total = 2.0 * disturbance
    for j in range(6):
        total += mobility[i, j] * swing[j]
    return total


@helper
def leap_bound(rate_noise: float, acceleration: float, T: float, T_was: float) -> float:
    """Largest leap of a leg's rate, m/s, that forces explain within T s.

    acceleration m/s^2: range of the leg's acceleration; T_was s: time over which the last mean acceleration
    was taken; rate_noise m/s of one reading.
    """
    return T * acceleration + 2.0 * rate_noise * (1.0 + T / T_was)


@helper
def sole(excess: Array) -> int:
    """The only leg whose share of its bound is above 1; -1 for no leg or several."""
    found = -1
    for i in range(6):
        if excess[i] > 1.0:
            if found >= 0:
                return -1
            found = i
    return found


@helper
def lag_of(T: float, T_was: float) -> float:
    """Largest error, m/s, of a rate that is a slope, per m/s^2 of acceleration range: a time, s.

    T s: last step of the slope; T_was s: the step before; 0: unknown, then the largest possible error.
    """
    return 0.5 * T * (T + T_was) / (2.0 * T + T_was) if T_was > 0.0 else 0.5 * T


@helper
def lag_of_leap(lag: float, lag_was: float, T: float, T_was: float) -> float:
    """Error of a slope's leap per m/s^2 of acceleration range, s; lag, lag_was: of the last two slopes."""
    return lag + lag_was * (1.0 + 2.0 * T / T_was)


@helper
def is_time(leg: int, leaps: Array, rates: Array, bounds: Array, latest: float) -> bool:
    """True if late sampling explains the leap of a leg's rate together with those of the other legs.

    leaps (6,) m/s, nan: unknown; rates (6,) m/s, before; bounds (6,) m/s of the leaps; latest: periods.
    """
    if isnan(leaps[leg]) or abs(leaps[leg]) > bounds[leg] + TIME_LEAPS * latest * abs(rates[leg]):
        return False
    return explained(leg, leaps, rates, bounds, leaps)


@helper
def stands(length: float, rate: float, anchor: float, noise: float, rate_noise: float) -> bool:
    """True if length (m) is at `anchor` and rate (m/s) is zero, within the noise of each reading."""
    return abs(length - anchor) <= noise and abs(rate) <= rate_noise


@helper
def strayed(deviation: Array, began: Array, age: Ints) -> float:
    """Largest change of a leg's deviation since a standstill began, m, over legs with a present reading.

    deviation (6,) m: length less reference; began (6,) m: its value when a reading began to stand still.
    """
    farthest = 0.0
    for j in range(6):
        if age[j] == 0:
            farthest = max(farthest, abs(deviation[j] - began[j]))
    return farthest
