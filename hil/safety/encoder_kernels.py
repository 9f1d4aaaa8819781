"""The rules on encoders of one tick: which leg is doubted, and which is pushed to see whether it moves."""

from math import inf, isnan
from typing import Any

import numpy as np

from drivers.arrays import Array
from drivers.compiled.compiler import helper
from drivers.signals import Doubt, Fault, Mode
from hil.safety import residuals

LONGEST_GAP = 8
"""Ticks without a leg after which its last reading says nothing of the next."""
STRAYS = 1.0
"""Share of a period by which a latch is off where an answer may be that to the SYNC or poll before."""
LEAST_m_s = 1e-9
"""A rate that leaps by less does not."""
RATE_MOVES = 3.0
"""So many times its noise make a rate that is not zero."""
(
    _DT, _GAP, _RATE, _BOUND, _RANGE, _LEAPED, _EXCESS, _DEVIATION, _SWING, _NOISE, _SAY, _LATE, _LAG, _LEAPS,
    _STRAY,
) = range(15)  # fmt: skip
"""Rows of a tick's scratch."""


@helper
def doubt_leg(tick: Any, limits: Any, memory: Any, leg: int, why: int, value: float, limit: float) -> None:
    """Remember a doubtful leg, and for the first one why.

    A length that jumped is no motion: where the leg has to stand, it stands there from now on.
    """
    if limits.watched_legs >> leg & 1 == 0:
        return
    memory.doubted |= 1 << leg
    memory.still[leg] = tick.length[leg]
    if memory.doubt == Doubt.NONE.value:
        memory.doubt, memory.doubt_value, memory.doubt_limit = why, value, limit


@helper
def forget_doubt(memory: Any) -> None:
    """Let no leg be doubted, nor for what was found before."""
    memory.doubt = memory.doubted = 0
    memory.doubt_value = memory.doubt_limit = 0.0
    memory.gaps[:] = 0.0
    memory.travel[:] = 0.0
    memory.excused[:] = 0.0


@helper
def swings(tick: Any, limits: Any, memory: Any, window: Array, swing: Array) -> None:
    """Fill swing (6,) N: largest less smallest of the forces that act between the readings to be compared.

    window: its first rows are the ring of the forces sent, (n, 6) N.
    """
    n, newest, rows = limits.window_ticks, memory.newest, limits.acting_ticks
    for i in range(6):
        if tick.age[i] == 0:
            since = min(tick.tick + 1 - memory.heard[i], LONGEST_GAP)
            rows = max(rows, limits.acting_ticks + since)
    for j in range(6):
        low, high = inf, -inf
        for k in range(min(rows + 1, n)):
            force = window[(newest - k) % n, j]
            low, high = min(low, force), max(high, force)
        swing[j] = high - low


@helper
def latched(tick: Any, leg: int) -> int:
    """Return when the encoder of a leg was latched for a tick, ns: when its SYNC or poll had gone out."""
    return int(tick.t_ns + tick.lateness_ns + tick.latch_ns[leg])


@helper
def compare(tick: Any, limits: Any, memory: Any, x: Array) -> float:
    """Fill time, gap, mean rate and bound of every leg heard now and lately; nan gap: it was not.

    The bounds allow for what a delay that is not shared may make of each gap: a whole period where no leg
    contradicts it, as a leg that is heard in its tick was latched in it.
    Returns how much later than the clock says the latch was, over the legs heard the last time any was.
    """
    for i in range(6):
        x[_GAP, i] = x[_SAY, i] = np.nan
        lost = memory.heard[i] == 0 or tick.tick + 1 - memory.heard[i] > LONGEST_GAP
        if tick.age[i] != 0 or lost:
            continue
        T = 1e-9 * (latched(tick, i) - memory.latched_ns[i])
        x[_DT, i] = T
        x[_RANGE, i] = residuals.acceleration_range(limits.mobility, x[_SWING], limits.disturbance_m_s2, i)
        lively = x[_RANGE, i] + abs(memory.acceleration[i])
        x[_NOISE, i] = limits.rate_noise_m_s + limits.rate_skew_s * lively
        rates = tick.rate[i] + memory.rate_was[i]
        x[_GAP, i] = tick.length[i] - memory.length_was[i] - 0.5 * T * rates  # trapezoidal rule
        # A late latch moves a length by the mean rate; where rates are made of lengths by the one before: a
        # jump of the length must not be what excuses it.
        x[_RATE, i] = memory.rate_was[i] if limits.differences != 0 else 0.5 * rates
        # Where no feedback names its SYNC or poll, the answer may be that to the one of the tick before: from
        # a tick on in which the leg was missed, or any where one SYNC serves all, until what was under way
        # then has been heard: each drive was late by itself.
        unsure = limits.unnamed != 0 and 0 < tick.tick + 1 - memory.missed_tick[i] <= LONGEST_GAP
        x[_STRAY, i] = STRAYS * limits.period_s if unsure else 0.0
        longest = T + x[_STRAY, i]
        x[_BOUND, i] = residuals.gap_bound(limits.length_noise_m, x[_NOISE, i], x[_RANGE, i], longest)
        if limits.differences != 0:
            x[_LAG, i] = residuals.lag_of(T, memory.spacing_s[i])
            x[_BOUND, i] += 0.5 * T * (x[_LAG, i] + memory.lag_s[i]) * x[_RANGE, i]
        if memory.heard[i] == memory.heard_tick:
            x[_SAY, i] = x[_GAP, i]
    delay, shared = residuals.shared_delay(x[_SAY], x[_RATE], x[_BOUND])
    for i in range(6):
        if not isnan(x[_GAP, i]):
            late = memory.delay_s + delay - memory.latched_delay_s[i]
            x[_DT, i] += late
            x[_GAP, i] -= late * x[_RATE, i]
    for i in range(6):
        period = limits.period_s * abs(x[_RATE, i])
        x[_LATE, i] = max(limits.unshared * limits.period_s, x[_STRAY, i]) * abs(x[_RATE, i])
        beyond = not shared and abs(x[_GAP, i]) > x[_BOUND, i] + x[_LATE, i]
        if beyond and residuals.explained(i, x[_GAP], x[_RATE], x[_BOUND], x[_SAY]):
            x[_LATE, i] = period
    for i in range(6):
        if not shared or x[_STRAY, i] > 0.0 or isnan(x[_SAY, i]):
            x[_BOUND, i] += x[_LATE, i]
    return delay


@helper
def fill_leaps(tick: Any, limits: Any, memory: Any, x: Array) -> None:
    """Fill how far each rate leaps, and as a share of what forces explain; nan and 0: not known."""
    x[_LEAPED] = np.nan
    for i in range(6):
        if not isnan(x[_GAP, i]) and memory.spacing_s[i] > 0.0 and x[_STRAY, i] == 0.0:
            leap = tick.rate[i] - memory.rate_was[i] - x[_DT, i] * memory.acceleration[i]
            bound = residuals.leap_bound(x[_NOISE, i], x[_RANGE, i], x[_DT, i], memory.spacing_s[i])
            if limits.differences != 0:
                lag = residuals.lag_of_leap(x[_LAG, i], memory.lag_s[i], x[_DT, i], memory.spacing_s[i])
                bound += lag * x[_RANGE, i]
            x[_LEAPS, i] = max(bound, LEAST_m_s)
            x[_LEAPED, i], x[_EXCESS, i] = leap, abs(leap) / x[_LEAPS, i]


@helper
def judge_lengths(tick: Any, limits: Any, memory: Any, x: Array) -> None:
    """Doubt legs whose length and rate contradict each other: at once, or within a while."""
    closed = tick.mode in (Mode.IDLE, Mode.LOADING, Mode.UNLOADING, Mode.PARKED)
    for i in range(6):
        gap, T = x[_GAP, i], x[_DT, i]
        if isnan(gap):
            continue
        if x[_EXCESS, i] > 1.0 and not closed:
            gap = residuals.beside(gap, x[_LEAPED, i], T)
        if abs(gap) > x[_BOUND, i]:
            doubt_leg(tick, limits, memory, i, Doubt.JUMP.value, gap, x[_BOUND, i])
        keep = max(1.0 - T / residuals.WINDOW_S, 0.0)
        memory.gaps[i] = keep * memory.gaps[i] + gap
        memory.travel[i] = keep * memory.travel[i] + abs(x[_RATE, i]) * T
        noise, share = limits.length_noise_m, limits.rate_error
        bound = residuals.slip_bound(noise, x[_NOISE, i], x[_RANGE, i], T, share, memory.travel[i])
        left, period = keep * memory.excused[i], limits.period_s
        bound += x[_LATE, i] + left
        calm = residuals.slip_bound(noise, x[_NOISE, i], x[_RANGE, i], 0.0, share, memory.travel[i])
        memory.excused[i] = residuals.excused(left, memory.gaps[i], calm, T, period)
        if abs(memory.gaps[i]) > bound:
            doubt_leg(tick, limits, memory, i, Doubt.SLIP.value, memory.gaps[i], bound)
        if limits.watched_legs >> i & 1:
            tick.encoder_share[i] = max(abs(gap) / x[_BOUND, i], abs(memory.gaps[i]) / bound)


@helper
def judge_rates(tick: Any, limits: Any, memory: Any, x: Array) -> None:
    """Doubt the one leg whose rate leaps; not where a late latch makes a difference of lengths leap."""
    leg = residuals.sole(x[_EXCESS])
    if leg < 0:
        return
    if limits.differences != 0 and residuals.is_time(leg, x[_LEAPED], x[_RATE], x[_LEAPS], limits.unshared):
        return
    doubt_leg(tick, limits, memory, leg, Doubt.LEAP.value, x[_LEAPED, leg], x[_LEAPS, leg])


@helper
def let_settle(memory: Any, deviation: Array, period_s: float) -> None:
    """Let no leg be suspected for what another one does that was pushed a moment ago."""
    for i in range(6):
        if memory.push[i] != 0:
            memory.unsettled_s[i] = residuals.SETTLES_S
        if memory.unsettled_s[i] > 0.0:
            memory.unsettled_s[i] -= period_s
            own = memory.began[i, i]
            memory.began[:, i] = deviation[i]
            memory.began[i, i] = own


@helper
def judge_stillness(tick: Any, limits: Any, memory: Any, x: Array) -> None:
    """Push legs whose reading stands still while they or others stray, and doubt those that do not move."""
    deviation = x[_DEVIATION]
    for i in range(6):
        deviation[i] = tick.length[i] - tick.q_d[i]
    let_settle(memory, deviation, limits.period_s)
    noise, moves = limits.length_noise_m, RATE_MOVES * limits.rate_noise_m_s
    for i in range(6):
        if tick.age[i] != 0 or not limits.watched_legs >> i & 1:
            continue
        length, rate = tick.length[i], tick.rate[i]
        if memory.stood[i] == 0 or not residuals.stands(length, rate, memory.anchor[i], noise, moves):
            memory.stood[i], memory.anchor[i], memory.push[i] = 1, length, 0
            memory.began[i, :] = deviation
            continue
        moved = residuals.strayed(deviation, memory.began[i], tick.age)
        if memory.push[i] != 0 or moved > residuals.SUSPECT * noise:
            towards = memory.push[i] < 0 or (memory.push[i] == 0 and deviation[i] > 0.0)
            memory.push[i] += -1 if towards else 1  # ticks; < 0 retracts the leg, first towards its reference
        if abs(memory.push[i]) > 2 * limits.push_ticks:
            doubt_leg(tick, limits, memory, i, Doubt.STILL.value, moved, residuals.SUSPECT * noise)


@helper
def remember_readings(tick: Any, limits: Any, memory: Any, delay: float, x: Array) -> None:
    """Keep what the next tick is compared with, and in which one each leg, or any, was last missed."""
    memory.delay_s += delay
    for i in range(6):
        if tick.age[i] != 0:
            if limits.apart != 0:
                memory.missed_tick[i] = tick.tick + 1
            else:
                memory.missed_tick[:] = tick.tick + 1
            continue
        if not isnan(x[_GAP, i]):
            memory.acceleration[i] = (tick.rate[i] - memory.rate_was[i]) / x[_DT, i]
            memory.spacing_s[i] = 0.0 if x[_STRAY, i] > 0.0 else x[_DT, i]
        else:
            memory.gaps[i] = memory.travel[i] = memory.excused[i] = 0.0
            memory.acceleration[i] = memory.spacing_s[i] = 0.0
        memory.length_was[i], memory.rate_was[i] = tick.length[i], tick.rate[i]
        memory.lag_s[i] = x[_LAG, i]
        memory.latched_ns[i], memory.latched_delay_s[i] = latched(tick, i), memory.delay_s
        memory.heard[i] = memory.heard_tick = tick.tick + 1


@helper
def judge_encoders(tick: Any, limits: Any, memory: Any, window: Array, is_open: bool) -> int:
    """Fill the doubted legs; return fault bits.

    window: see `hil.safety.force_limits`, its newest row `memory.newest`. is_open: all drives are in RUN and
    the law moves the platform; rates and standstill count once the brakes have had their time to open.
    """
    tick.legs_doubted, tick.doubt, tick.doubt_value, tick.doubt_limit = 0, Doubt.NONE.value, 0.0, 0.0
    tick.encoder_share[:] = np.nan
    if limits.watched_legs == 0:
        return 0
    memory.open_for = memory.open_for + 1 if is_open else 0
    settled = memory.open_for > limits.open_ticks
    x = np.zeros((15, 6))
    swings(tick, limits, memory, window, x[_SWING])
    delay = compare(tick, limits, memory, x)
    if tick.mode < Mode.IDLE:
        forget_doubt(memory)
    elif memory.doubted == 0 and tick.mode != Mode.FAULT:
        fill_leaps(tick, limits, memory, x)
        judge_lengths(tick, limits, memory, x)
        if settled:
            judge_rates(tick, limits, memory, x)
            judge_stillness(tick, limits, memory, x)
    if not settled or memory.doubted != 0:
        memory.stood[:] = 0
        memory.push[:] = 0
    remember_readings(tick, limits, memory, delay, x)
    tick.legs_doubted, tick.doubt = memory.doubted, memory.doubt
    tick.doubt_value, tick.doubt_limit = memory.doubt_value, memory.doubt_limit
    return Fault.ENCODER.value if memory.doubted != 0 else 0


@helper
def pushing(memory: Any) -> bool:
    """Tell whether a leg is being pushed."""
    for i in range(6):  # noqa: SIM110 - compiled
        if memory.push[i] != 0 or memory.pushed_N[i] != 0.0:
            return True
    return False


@helper
def push_legs(tau: Array, limits: Any, memory: Any) -> None:
    """Add the pushes to tau (6,) N."""
    for i in range(6):
        rise, ticks = limits.rise_ticks, limits.push_ticks
        force = residuals.push_of(memory.push[i], ticks, limits.push_N[i], limits.sticks != 0, rise)
        most = 2.0 * limits.push_N[i] / max(ticks - 2 * (rise - 1), 1)
        if limits.sticks != 0 and memory.push[i] != 0:
            most = max(most, 2.0 * limits.push_N[i] / (2 * rise - 1))
        memory.pushed_N[i] = min(max(force, memory.pushed_N[i] - most), memory.pushed_N[i] + most)
        tau[i] += memory.pushed_N[i]
