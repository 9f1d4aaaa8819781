"""The encoder checks of one tick: doubtful legs, and legs to be probed by a push (`hil.loop.probe`)."""

from math import inf, isnan
from typing import Any

import numpy as np

from drivers.arrays import Array
from drivers.compiled.compiler import helper
from drivers.signals import Doubt, Fault, Mode
from hil.safety import residuals
from hil.safety.second_encoders import NONE, STOPS, judge_second

LONGEST_GAP = 8
"""Longest gap, in ticks, over which a leg's last reading is compared with the next."""
STRAYS = 1.0
"""Share of a period by which a latch may be off if the answer may belong to the SYNC or poll before."""
LEAST_m_s = 1e-9
"""Smallest leap of a rate that counts."""
RATE_MOVES = 3.0
"""A rate above this multiple of its noise is not zero."""
COMPARED = np.dtype(
    [
        ("elapsed", "<f8"),  # s, between two latches
        ("gap", "<f8"),  # m, length less what the rates make of it; nan: the leg was not heard
        ("say", "<f8"),  # m, the gap of a leg that bears witness of a delay; nan: it does not
        ("rate", "<f8"),  # m/s, the mean one
        ("bound", "<f8"),  # m, of the gap
        ("late", "<f8"),  # m, of it, by a latch that is late by itself
        ("stray", "<f8"),  # s, by which the answer may be that to another SYNC or poll
        ("swing", "<f8"),  # N, largest less smallest force that acts meanwhile
        ("range", "<f8"),  # m/s^2, over which the acceleration may vary
        ("noise", "<f8"),  # m/s, of a rate
        ("lag", "<f8"),  # s, of a rate that is a difference
        ("leap", "<f8"),  # m/s, of the rate; nan: unknown
        ("leap_bound", "<f8"),
        ("excess", "<f8"),  # the leap over its bound
        ("deviation", "<f8"),  # m, length less reference
    ]
)
"""Quantities that a tick compares for each leg."""


@helper
def doubt_leg(tick: Any, limits: Any, memory: Any, leg: int, why: int, value: float, limit: float) -> None:
    """Mark a leg's encoder as doubtful; store reason (Doubt), value and limit of the first one.

    A length that jumped is not a motion: a leg that must stand still now has to stand at the new length.
    """
    if limits.watched_legs >> leg & 1 == 0:
        return
    memory.doubted |= 1 << leg
    memory.still[leg] = tick.length[leg]
    if memory.doubt == Doubt.NONE.value:
        memory.doubt, memory.doubt_value, memory.doubt_limit = why, value, limit


@helper
def forget_doubt(memory: Any) -> None:
    """Clear all doubts about encoders, and the sums behind them."""
    memory.doubt = memory.doubted = 0
    memory.doubt_value = memory.doubt_limit = 0.0
    memory.gaps[:] = 0.0
    memory.travel[:] = 0.0
    memory.excused[:] = 0.0


@helper
def swings(tick: Any, limits: Any, memory: Any, window: Array, swing: Array) -> None:
    """Fill swing (6,) N: range of the forces on each leg that act between the compared readings.

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
    """Time at which the encoder of a leg was sampled, ns: when its SYNC or poll had been sent."""
    return int(tick.t_ns + tick.lateness_ns + tick.latch_ns[leg])


@helper
def compare(tick: Any, limits: Any, memory: Any, x: Any) -> float:
    """Fill in time, gap, mean rate and bound of each leg with a present and a recent reading; else nan gap.

    A gap, m, is the length change less mean rate times time. The bounds include a delay of one leg alone: a
    whole period if no other leg contradicts it, as a leg that answers in a tick was sampled in that tick.
    Returns the delay of the sampling beyond the clock's time, s, common to the legs that reported in the last
    tick with reports.
    """
    for i in range(6):
        x["gap"][i] = x["say"][i] = np.nan
        lost = memory.heard[i] == 0 or tick.tick + 1 - memory.heard[i] > LONGEST_GAP
        if tick.age[i] != 0 or lost:
            continue
        T = 1e-9 * (latched(tick, i) - memory.latched_ns[i])
        x["elapsed"][i] = T
        x["range"][i] = residuals.acceleration_range(limits.mobility, x["swing"], limits.disturbance_m_s2, i)
        lively = x["range"][i] + abs(memory.acceleration[i])
        x["noise"][i] = limits.rate_noise_m_s + limits.rate_skew_s * lively
        rates = tick.rate[i] + memory.rate_was[i]
        x["gap"][i] = tick.length[i] - memory.length_was[i] - 0.5 * T * rates  # trapezoidal rule
        # A late latch moves a length by the mean rate; where rates are made of lengths by the one before: a
        # jump of the length must not be what excuses it.
        x["rate"][i] = memory.rate_was[i] if limits.differences != 0 else 0.5 * rates
        # Where no feedback names its SYNC or poll, the answer may be that to the one of the tick before: from
        # a tick on in which the leg was missed, or any where one SYNC serves all, until what was under way
        # then has been heard: each drive was late by itself.
        unsure = limits.unnamed != 0 and 0 < tick.tick + 1 - memory.missed_tick[i] <= LONGEST_GAP
        x["stray"][i] = STRAYS * limits.period_s if unsure else 0.0
        longest = T + x["stray"][i]
        x["bound"][i] = residuals.gap_bound(limits.length_noise_m, x["noise"][i], x["range"][i], longest)
        if limits.differences != 0:
            x["lag"][i] = residuals.lag_of(T, memory.spacing_s[i])
            x["bound"][i] += 0.5 * T * (x["lag"][i] + memory.lag_s[i]) * x["range"][i]
        if memory.heard[i] == memory.heard_tick:
            x["say"][i] = x["gap"][i]
    delay, shared = residuals.shared_delay(x["say"], x["rate"], x["bound"])
    for i in range(6):
        if not isnan(x["gap"][i]):
            late = memory.delay_s + delay - memory.latched_delay_s[i]
            x["elapsed"][i] += late
            x["gap"][i] -= late * x["rate"][i]
    for i in range(6):
        period = limits.period_s * abs(x["rate"][i])
        x["late"][i] = max(limits.unshared * limits.period_s, x["stray"][i]) * abs(x["rate"][i])
        beyond = not shared and abs(x["gap"][i]) > x["bound"][i] + x["late"][i]
        if beyond and residuals.explained(i, x["gap"], x["rate"], x["bound"], x["say"]):
            x["late"][i] = period
    for i in range(6):
        if not shared or x["stray"][i] > 0.0 or isnan(x["say"][i]):
            x["bound"][i] += x["late"][i]
    return delay


@helper
def fill_leaps(tick: Any, limits: Any, memory: Any, x: Any) -> None:
    """Fill in each rate's unexplained change (leap), m/s, and its share of the bound; unknown: nan and 0."""
    x["leap"][:] = np.nan
    for i in range(6):
        if not isnan(x["gap"][i]) and memory.spacing_s[i] > 0.0 and x["stray"][i] == 0.0:
            leap = tick.rate[i] - memory.rate_was[i] - x["elapsed"][i] * memory.acceleration[i]
            bound = residuals.leap_bound(x["noise"][i], x["range"][i], x["elapsed"][i], memory.spacing_s[i])
            if limits.differences != 0:
                lag = residuals.lag_of_leap(
                    x["lag"][i], memory.lag_s[i], x["elapsed"][i], memory.spacing_s[i]
                )
                bound += lag * x["range"][i]
            x["leap_bound"][i] = max(bound, LEAST_m_s)
            x["leap"][i], x["excess"][i] = leap, abs(leap) / x["leap_bound"][i]


@helper
def judge_lengths(tick: Any, limits: Any, memory: Any, x: Any) -> None:
    """Mark legs whose length and rate contradict each other, at once or over some time, as doubtful."""
    closed = tick.mode in (Mode.IDLE, Mode.LOADING, Mode.UNLOADING, Mode.PARKED)
    for i in range(6):
        gap, T = x["gap"][i], x["elapsed"][i]
        if isnan(gap):
            continue
        if x["excess"][i] > 1.0 and not closed:
            gap = residuals.beside(gap, x["leap"][i], T)
        if abs(gap) > x["bound"][i]:
            doubt_leg(tick, limits, memory, i, Doubt.JUMP.value, gap, x["bound"][i])
        keep = max(1.0 - T / residuals.WINDOW_S, 0.0)
        memory.gaps[i] = keep * memory.gaps[i] + gap
        memory.travel[i] = keep * memory.travel[i] + abs(x["rate"][i]) * T
        noise, share = limits.length_noise_m, limits.rate_error
        bound = residuals.slip_bound(noise, x["noise"][i], x["range"][i], T, share, memory.travel[i])
        left, period = keep * memory.excused[i], limits.period_s
        bound += x["late"][i] + left
        calm = residuals.slip_bound(noise, x["noise"][i], x["range"][i], 0.0, share, memory.travel[i])
        memory.excused[i] = residuals.excused(left, memory.gaps[i], calm, T, period)
        if abs(memory.gaps[i]) > bound:
            doubt_leg(tick, limits, memory, i, Doubt.SLIP.value, memory.gaps[i], bound)
        if limits.watched_legs >> i & 1:
            tick.encoder_share[i] = max(abs(gap) / x["bound"][i], abs(memory.gaps[i]) / bound)


@helper
def judge_rates(tick: Any, limits: Any, memory: Any, x: Any) -> None:
    """Mark the only leg whose rate leaps as doubtful, unless late sampling explains the leap."""
    leg = residuals.sole(x["excess"])
    if leg < 0:
        return
    if limits.differences != 0 and residuals.is_time(
        leg, x["leap"], x["rate"], x["leap_bound"], limits.unshared
    ):
        return
    doubt_leg(tick, limits, memory, leg, Doubt.LEAP.value, x["leap"][leg], x["leap_bound"][leg])


@helper
def let_settle(memory: Any, deviation: Array, period_s: float) -> None:
    """After a push on a leg, let no other leg be suspected because of that leg's settling motion."""
    for i in range(6):
        if memory.push[i] != 0:
            memory.unsettled_s[i] = residuals.SETTLES_S
        if memory.unsettled_s[i] > 0.0:
            memory.unsettled_s[i] -= period_s
            own = memory.began[i, i]
            memory.began[:, i] = deviation[i]
            memory.began[i, i] = own


@helper
def judge_stillness(tick: Any, limits: Any, memory: Any, x: Any) -> None:
    """Suspect legs that stand still while a leg strays; doubt those that do not move under a push."""
    deviation = x["deviation"]
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
            memory.free_m[i] = memory.free_m_s[i] = 0.0
            memory.began[i] = deviation
            continue
        moved = residuals.strayed(deviation, memory.began[i], tick.age)
        if memory.push[i] != 0 or moved > residuals.SUSPECT * noise:
            if limits.sticks != 0:
                memory.strays |= 1 << i
            else:
                towards = memory.push[i] < 0 or (memory.push[i] == 0 and deviation[i] > 0.0)
                memory.push[i] += -1 if towards else 1  # first towards its reference
        ways = 2 if limits.sticks == 0 or memory.both_ways >> i & 1 else 1
        if abs(memory.push[i]) > ways * limits.push_ticks:
            doubt_leg(tick, limits, memory, i, Doubt.STILL.value, moved, residuals.SUSPECT * noise)


@helper
def remember_readings(tick: Any, limits: Any, memory: Any, delay: float, x: Any) -> None:
    """Store the readings for the next comparison, and when each leg, or any, was last missed."""
    memory.delay_s += delay
    for i in range(6):
        if tick.age[i] != 0:
            if limits.apart != 0:
                memory.missed_tick[i] = tick.tick + 1
            else:
                memory.missed_tick[:] = tick.tick + 1
            continue
        if not isnan(x["gap"][i]):
            memory.acceleration[i] = (tick.rate[i] - memory.rate_was[i]) / x["elapsed"][i]
            memory.spacing_s[i] = 0.0 if x["stray"][i] > 0.0 else x["elapsed"][i]
        else:
            memory.gaps[i] = memory.travel[i] = memory.excused[i] = 0.0
            memory.acceleration[i] = memory.spacing_s[i] = 0.0
        memory.length_was[i], memory.rate_was[i] = tick.length[i], tick.rate[i]
        memory.lag_s[i] = x["lag"][i]
        memory.latched_ns[i], memory.latched_delay_s[i] = latched(tick, i), memory.delay_s
        memory.heard[i] = memory.heard_tick = tick.tick + 1


@helper
def judge_encoders(tick: Any, limits: Any, memory: Any, window: Array, is_open: bool) -> int:
    """Fill in the legs with doubtful encoders; returns fault bits.

    window: see `hil.safety.force_limits`, its newest row `memory.newest`. is_open: all drives are in RUN and
    the law moves the platform. Rates and standstill are checked once the brakes have had time to open.
    """
    tick.legs_doubted, tick.doubt, tick.doubt_value, tick.doubt_limit = 0, Doubt.NONE.value, 0.0, 0.0
    tick.encoder_share[:] = np.nan
    if limits.watched_legs == 0 and limits.second == NONE:
        return 0
    memory.open_for = memory.open_for + 1 if is_open else 0
    settled = memory.open_for > limits.open_ticks
    memory.strays = 0
    x = np.zeros(6, COMPARED)
    swings(tick, limits, memory, window, x["swing"])
    delay = compare(tick, limits, memory, x)
    if tick.mode < Mode.IDLE:
        forget_doubt(memory)
    elif memory.doubted == 0 and tick.mode != Mode.FAULT:
        fill_leaps(tick, limits, memory, x)
        judge_lengths(tick, limits, memory, x)
        if settled:
            judge_rates(tick, limits, memory, x)
            judge_stillness(tick, limits, memory, x)
        if limits.second != NONE:
            legs, why, value, limit = judge_second(tick, limits, memory, x)
            if legs and limits.second == STOPS and memory.doubted == 0:
                memory.doubted, memory.doubt = legs, why
                memory.doubt_value, memory.doubt_limit = value, limit
    if not settled or memory.doubted != 0:
        memory.stood[:] = memory.push[:] = 0
        memory.strays = 0
    remember_readings(tick, limits, memory, delay, x)
    tick.legs_doubted, tick.doubt = memory.doubted, memory.doubt
    tick.doubt_value, tick.doubt_limit = memory.doubt_value, memory.doubt_limit
    return Fault.ENCODER.value if memory.doubted != 0 else 0


@helper
def probed(tick: Any, memory: Any) -> bool:
    """True while a leg gets a probe push."""
    for i in range(6):  # noqa: SIM110 - compiled
        if memory.push[i] != 0 or tick.probe_force[i] != 0.0:
            return True
    return False
