"""Which of two encoders of a leg is wrong, where they contradict each other.

Wrong is the drive's encoder where the rules on it alone find so, or where the leg's brake is closed and only
its length changed, or where the tracker agrees with the second one. Wrong is the second one where it alone
changed on a closed brake, where the tracker agrees with the drive's, or where their difference changed by
more than an error of the drive's encoder could without violating those rules. Else it is one of two.
"""

from math import isinf, isnan, nan
from typing import Any

from drivers.compiled.compiler import helper
from drivers.signals import LEGS, Doubt, Mode
from drivers.tick_columns import SENSORS

LENGTH = SENSORS.index("length_0")
"""Place of leg 0 in column `sensor_share`."""
QUIET = 0.5
"""Share of its limit below which a difference counts as none."""
SURE = 4.0
"""Standard deviations of the tracker's mean that a decision by it needs."""
FAST_S, SLOW_S, BASE_S = 0.01, 0.1, 1.0
"""Times of the two means whose difference shows how fast the encoders come apart, and of the mean of the
tracker's difference while they agree."""
NONE, STOPS, WARNS = range(3)
"""`second` of the limits: no second encoders; fault, or only a warning, where they contradict the drive's."""
SECOND_MEMORY = [
    ("followed", "<i8"),  # bit i: the difference of leg i is known
    ("sampled", "<i8", (LEGS,)),  # tick of its last sample
    ("apart", "<i8", (LEGS,)),  # ticks since the two encoders contradict each other; < 0: agree
    ("gap_was", "<f8", (LEGS,)), ("gap_fast", "<f8", (LEGS,)), ("gap_slow", "<f8", (LEGS,)),  # m
    ("gap_like", "<f8", (LEGS,)),  # m, a mean over the same time as that of the tracker
    ("tracker_was", "<f8", (LEGS,)),  # m, tracker less drive's encoder while the two agreed
    ("rests", "<i8"), ("rest_length", "<f8", (LEGS,)), ("rest_gap", "<f8", (LEGS,)),  # as brakes closed, m
    ("suspect_tick", "<i8", (LEGS,)),  # until then the second encoder alone counts as wrong
    ("second_wrong", "<i8"),  # bit i: the second encoder of leg i is the wrong one
]  # fmt: skip
"""Fields of the memory of these rules."""


@helper
def by_tracker(tick: Any, leg: int) -> float:
    """Length of a leg by the tracker less that by the drive's encoder, m, to first order; nan without one."""
    total = 0.0
    for j in range(6):
        total += tick.J[leg, j] * tick.tracker_gap[j]
    return total


@helper
def _follow(tick: Any, limits: Any, memory: Any, leg: int, allowed: float, x: Any) -> None:
    """Store a leg's difference; suspect its second encoder if that changed faster than the drive's could."""
    gap, now = tick.length_gap[leg], tick.length_gap_now[leg]
    if memory.followed >> leg & 1 == 0:
        memory.followed |= 1 << leg
        memory.gap_was[leg] = memory.gap_fast[leg] = memory.gap_slow[leg] = memory.gap_like[leg] = gap
        memory.tracker_was[leg], memory.sampled[leg] = nan, tick.tick
    if isnan(now):
        return
    jump, dt = abs(now - memory.gap_was[leg]), (tick.tick - memory.sampled[leg]) * limits.period_s
    memory.gap_was[leg], memory.sampled[leg] = now, tick.tick
    memory.gap_fast[leg] += (now - memory.gap_fast[leg]) * min(dt / FAST_S, 0.5)
    memory.gap_slow[leg] += (now - memory.gap_slow[leg]) * min(dt / SLOW_S, 1.0)
    memory.gap_like[leg] += (now - memory.gap_like[leg]) * min(dt / limits.tracker_s, 1.0)
    if x["leap_bound"][leg] > 0.0 and limits.watched_legs >> leg & 1:
        late = allowed + limits.period_s * abs(tick.rate[leg])
        swift = abs(memory.gap_fast[leg] - memory.gap_slow[leg]) > late + SLOW_S * x["leap_bound"][leg]
        if swift or jump > late + limits.second_m + x["bound"][leg]:
            memory.suspect_tick[leg] = tick.tick + 1 + limits.second_ticks


@helper
def _on_brake(tick: Any, memory: Any, leg: int, allowed: float) -> int:
    """Find what moved on a closed brake: Doubt.SECOND the drive's encoder, -1 the second one, 0 neither."""
    if memory.rests >> leg & 1 == 0:
        memory.rests |= 1 << leg
        memory.rest_length[leg], memory.rest_gap[leg] = tick.length[leg], memory.gap_fast[leg]
    moved, apart = tick.length[leg] - memory.rest_length[leg], memory.gap_fast[leg] - memory.rest_gap[leg]
    if abs(apart) <= allowed:
        return 0
    return Doubt.SECOND.value if abs(moved) > abs(moved + apart) else -1


@helper
def _decided(tick: Any, limits: Any, memory: Any, leg: int) -> int:
    """Doubt.SECOND: the drive's encoder is wrong; -1: the second one; Doubt.EITHER; 0: not yet decided."""
    if memory.apart[leg] < limits.second_ticks:
        return 0
    gap, seen = memory.gap_like[leg], by_tracker(tick, leg) - memory.tracker_was[leg]
    if isnan(seen):
        return Doubt.EITHER.value
    least = SURE * limits.tracker_std_m
    if abs(seen) - abs(seen - gap) > 2.0 * least:
        return Doubt.SECOND.value
    if abs(seen - gap) - abs(seen) > 2.0 * least:
        return -1
    return Doubt.EITHER.value if memory.apart[leg] > limits.tracker_ticks else 0


@helper
def judge_second(tick: Any, limits: Any, memory: Any, x: Any) -> tuple[int, int, float, float]:
    """Compare the two encoders of each leg; returns leg bits, the reason (Doubt), difference and limit, m.

    x: what `hil.safety.encoder_rules` compared, with its bounds. The bits are those of legs whose drive's
    encoder is, or may be, wrong.
    """
    rests = tick.mode in (Mode.IDLE, Mode.LOADING, Mode.UNLOADING, Mode.PARKED)
    legs, why, value, limit = 0, 0, 0.0, 0.0
    if not rests:
        memory.rests = 0
    for leg in range(LEGS):
        gap, share = tick.length_gap[leg], tick.sensor_share[LENGTH + leg]
        if isnan(gap) or isinf(share) or (tick.legs_lost | tick.legs_slipped) >> leg & 1:
            continue
        allowed = limits.second_m + limits.second_late_s * abs(tick.rate[leg])
        _follow(tick, limits, memory, leg, allowed, x)
        found = _on_brake(tick, memory, leg, allowed) if rests else 0
        if share > 1.0:
            memory.apart[leg] = max(memory.apart[leg], 0) + 1
            if memory.apart[leg] <= limits.second_ticks and tick.tick < memory.suspect_tick[leg]:
                memory.second_wrong |= 1 << leg
            found = found or _decided(tick, limits, memory, leg)
        else:
            memory.apart[leg] = min(memory.apart[leg], 0) - 1 if share < QUIET else 0
            if -memory.apart[leg] * limits.period_s > BASE_S:
                memory.second_wrong &= ~(1 << leg)
            seen = by_tracker(tick, leg)
            if share < QUIET and not isnan(seen):
                was = seen if isnan(memory.tracker_was[leg]) else memory.tracker_was[leg]
                memory.tracker_was[leg] = was + (seen - was) * limits.period_s / BASE_S
        if found < 0:
            memory.second_wrong |= 1 << leg
        if found > 0 and (memory.second_wrong | memory.doubted) >> leg & 1 == 0:
            legs |= 1 << leg
            if why == 0:
                why, value, limit = found, gap, allowed
    return legs, why, value, limit
