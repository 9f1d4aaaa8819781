"""Rules on encoders combined: which legs are doubted and when, parts of a bound, and time."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.signals import Doubt, Fault, Mode
from hil.safety.second_encoders import LENGTH, STOPS, WARNS
from tests.hil.encoder_bench import (
    BOTH_SIGNS,
    CREEP,
    ON_ONE_LEG,
    PERIOD_NS,
    RATES,
    Bench,
    T,
    after,
    calm,
    doubted,
    six,
)

# -- who is doubted, when, and until when


@ON_ONE_LEG
@BOTH_SIGNS
def test_encoders_flag_a_length_jump_beyond_the_noise_of_two_readings(leg, sign):
    after(2, length_noise_m=0.25).ticks(1, jump=six(sign * 0.5, leg))
    bench = after(2, length_noise_m=0.25)
    assert doubted(bench.tick(jump=six(sign * 0.501, leg)), Doubt.JUMP, leg, sign * 0.501, 0.5 + CREEP)
    assert bench.faults == Fault.ENCODER


def test_encoders_allow_a_length_change_exactly_at_its_bound():
    bound = float(after(2, length=0.0).tick(jump=six(1.0, 3))["doubt_limit"])
    after(2, length=0.0).ticks(1, jump=six(bound, 3))


def test_encoders_report_the_unexplained_length_change_of_watched_legs_as_share_of_its_bound():
    bench = Bench(length_noise_m=0.25, watched_legs=0b010111)
    assert np.isnan(bench.tick()["encoder_share"]).all()
    assert np.array_equal(bench.tick()["encoder_share"], [0.0, 0.0, 0.0, np.nan, 0.0, np.nan], equal_nan=True)
    shares = bench.tick(jump=six(-0.125, 2))["encoder_share"]
    assert shares[2] == pytest.approx(0.125 / (0.5 + CREEP), rel=1e-9)
    assert np.array_equal(np.delete(shares, 2), [0.0, 0.0, np.nan, 0.0, np.nan], equal_nan=True)
    assert bench.tick(jump=six(3.0, 4))["encoder_share"][4] == pytest.approx(3.0 / (0.5 + CREEP), rel=1e-9)
    assert np.isnan(bench.tick()["encoder_share"]).all(), "no leg is checked after one has been flagged"


@BOTH_SIGNS
def test_encoders_report_the_larger_share_of_one_length_change_and_of_the_recent_sum(sign):
    bench = after(2, length_noise_m=0.25)
    shares = [bench.tick(jump=six(sign * 0.125, 1))["encoder_share"][1] for _ in range(3)]
    assert shares[0] == pytest.approx(0.125 / (0.5 + CREEP), rel=1e-9)
    assert 1.5 * shares[0] < shares[1] < shares[2] < 1.0
    bench = after(2, length_noise_m=0.25)
    bench.ticks(1, jump=six(sign * 0.25, 1))
    share = bench.tick(jump=six(-sign * 0.375, 1))["encoder_share"][1]
    assert share == pytest.approx(0.375 / (0.5 + CREEP), rel=1e-9)


def test_encoders_are_compared_from_the_second_reading_on():
    assert calm(Bench().tick(jump=9.0))
    bench = Bench()
    bench.tick()
    assert doubted(bench.tick(jump=six(9.0, 2)), Doubt.JUMP, 2, 9.0, CREEP)


@pytest.mark.parametrize("mode", Mode)
def test_encoders_are_checked_in_all_modes_except_waiting_and_fault(mode):
    bench = after(2, mode=mode)
    tick = bench.tick(jump=six(1.0, 3), mode=mode)
    assert calm(tick) == (mode in {Mode.WAITING, Mode.FAULT})
    assert bool(bench.faults & Fault.ENCODER) != calm(tick)


def test_encoders_keep_the_first_flagged_leg_and_value_until_the_mode_waiting():
    bench = after(2)
    bench.tick(jump=six(1.0, 3))
    for mode in (Mode.HELD, Mode.FAULT, Mode.IDLE):
        assert doubted(bench.tick(jump=six(2.0, 1), mode=mode), Doubt.JUMP, 3, 1.0, CREEP)
        assert bench.faults & Fault.ENCODER
    bench.ticks(1, mode=Mode.WAITING)
    assert bench.faults == Fault.NONE
    assert not bench.memory("gaps").any()
    assert not bench.memory("travel").any()
    assert not bench.memory("excused").any()
    assert doubted(bench.tick(jump=six(-2.0, 1), mode=Mode.IDLE), Doubt.JUMP, 1, -2.0, CREEP)


def test_encoders_report_the_reason_of_the_first_of_two_flagged_legs():
    tick = after(2).tick(jump=[0.0, 0.0, 3.0, 0.0, 4.0, 0.0])
    assert tick["legs_doubted"] == 0b010100
    assert (tick["doubt"], tick["doubt_value"]) == (Doubt.JUMP, 3.0)


@ON_ONE_LEG
def test_encoders_of_unwatched_legs_are_not_flagged(leg):
    bench = after(2, watched_legs=63 - (1 << leg))
    bench.ticks(1, jump=six(1.0, leg))
    other = (leg + 1) % 6
    assert doubted(bench.tick(jump=six(1.0, other)), Doubt.JUMP, other, 1.0, CREEP)
    assert doubted(after(2, watched_legs=1 << leg).tick(jump=six(1.0, leg)), Doubt.JUMP, leg, 1.0, CREEP)
    bench = after(2, watched_legs=0)
    bench.ticks(1, jump=six(1.0, leg))
    assert bench.faults == Fault.NONE


BRAKING = [Mode.RELEASING, Mode.TRACKING, Mode.STOPPING, Mode.PARKING, Mode.HELD]
"""Modes in which a brake may close on a leg that moves."""
SHUT = [Mode.IDLE, Mode.LOADING, Mode.UNLOADING, Mode.PARKED]


@pytest.mark.parametrize("share", [0.0, 1.0])
@pytest.mark.parametrize("mode", BRAKING + SHUT)
def test_encoders_flag_a_leg_that_stops_within_one_tick_only_on_closed_brakes(mode, share):
    """0.5 x 8 m/s x T = 62.5 mm more than the rates explain; 2 x 10 mm are noise, 19 mm a late latch."""
    bench = after(3, rate=8.0, mode=mode, length_noise_m=0.01)
    tick = bench.tick(rate=six(0.0, 1, 8.0), jump=six((0.5 - share) * 8.0 * T, 1), mode=mode)
    if mode in SHUT:
        assert tick["doubt"] == Doubt.JUMP
        return
    assert calm(tick)
    assert bench.faults == Fault.NONE
    assert calm(bench.tick(mode=mode))


def test_encoders_measure_the_jump_of_a_stopped_leg_beyond_the_length_lost_by_stopping():
    bench = after(2, mode=Mode.IDLE)
    assert bench.tick(jump=six(1.0, 3), mode=Mode.IDLE)["legs_moved"] == 0, "an encoder jump is no leg motion"
    assert bench.faults == Fault.ENCODER
    tick = after(3, rate=8.0, length_noise_m=0.01).tick(rate=six(0.0, 1, 8.0), jump=six(4.0 * T + 0.05, 1))
    assert doubted(tick, Doubt.JUMP, 1, 0.05, 0.02 + CREEP + 0.3 * T * 4.0)


@pytest.mark.parametrize(("disturbance", "excused"), [(256.0, False), (255.0, True)])
def test_encoders_flag_a_length_jump_during_a_stop_that_forces_explain(disturbance, excused):
    """8 m/s are 1 / 64 s x 2 x 256 m/s^2: the rate has not leapt, so a gap of 62.5 mm is a jump."""
    bench = after(3, rate=8.0, length_noise_m=0.001, disturbance_m_s2=disturbance)
    tick = bench.tick(rate=six(0.0, 1, 8.0), jump=six(4.0 * T, 1))
    assert calm(tick) == excused
    assert tick["doubt"] == (Doubt.NONE if excused else Doubt.JUMP)


# -- what a bound is made of


@BOTH_SIGNS
def test_encoders_length_change_bound_grows_with_rate_noise_and_leg_acceleration(sign):
    """A rate latched 0.5 s away from its length is off by half of 4 + 3 m/s^2; 4: from -2 to 2."""
    bench = after(2, rate=six(-sign * 3.0 * T, 1), rate_noise_m_s=0.25, rate_skew_s=0.5, disturbance_m_s2=2.0)
    bench.ticks(1, rate=0.0)
    limit = T * (0.25 + 0.5 * (4.0 + 3.0)) + 4.0 * T * T / 8.0 + CREEP
    assert doubted(bench.tick(jump=six(9.0, 1)), Doubt.JUMP, 1, 9.0, limit)


FORCE_N = 8.0 / T**2
"""With a mobility of 1/kg this change widens a bound by 1 m."""


def pushed_by(then, acting_ticks=3, first=20, unseen=(), away=0):
    """A bench on whose leg 2 forces (n,) of leg 5 acted; `unseen` legs are silent in the last `away` ticks."""
    mobility = np.zeros((6, 6))
    mobility[2, 5] = 1.0
    bench = Bench(mobility=mobility, acting_ticks=acting_ticks)
    for n, force in enumerate([0.0] * first + then):
        hidden = unseen if n >= first + len(then) - away else ()
        bench.ticks(1, tau_asked=six(force, 5), unseen=hidden)
    return bench


@BOTH_SIGNS
@pytest.mark.parametrize(("acting", "reach"), [(3, 4), (0, 1), (13, 14), (14, 15), (40, 15)])
def test_encoders_length_change_bound_is_wider_until_a_force_change_has_fully_acted(sign, acting, reach):
    bench = pushed_by([sign * FORCE_N] * reach, acting)
    assert doubted(bench.tick(jump=six(1.5, 2)), Doubt.JUMP, 2, 1.5, 1.0 + CREEP)
    bench = pushed_by([sign * FORCE_N] * (reach + 1), acting)
    assert doubted(bench.tick(jump=six(0.5, 2)), Doubt.JUMP, 2, 0.5, CREEP)


@BOTH_SIGNS
@pytest.mark.parametrize("after", range(5))
def test_encoders_length_change_bound_is_wider_for_a_force_pulse_as_long_as_for_a_step(sign, after):
    bench = pushed_by([sign * FORCE_N] + [0.0] * after)
    assert doubted(bench.tick(jump=six(1.5, 2)), Doubt.JUMP, 2, 1.5, 1.0 + CREEP)
    assert doubted(pushed_by([FORCE_N] + [0.0] * 5).tick(jump=six(0.5, 2)), Doubt.JUMP, 2, 0.5, CREEP)


@pytest.mark.parametrize(("away", "reach"), [(2, 6), (7, 11), (9, 11)])
@pytest.mark.parametrize("silent", [0, 5])
def test_encoders_length_change_bound_includes_forces_during_a_silence_of_the_leg(silent, away, reach):
    """Eight ticks at most: after a longer silence readings are not compared."""
    bench = pushed_by([FORCE_N] * reach, unseen=[silent], away=away)
    assert doubted(bench.tick(jump=six(1.5, 2)), Doubt.JUMP, 2, 1.5, 1.0 + CREEP)
    bench = pushed_by([FORCE_N] * (reach + 1), unseen=[silent], away=away)
    assert doubted(bench.tick(jump=six(0.5, 2)), Doubt.JUMP, 2, 0.5, CREEP)
    bench = pushed_by([FORCE_N] * 5, unseen=[1], away=3)
    assert doubted(bench.tick(jump=six(0.5, 2), unseen=[1]), Doubt.JUMP, 2, 0.5, CREEP)


@ON_ONE_LEG
@pytest.mark.parametrize("before", [1, 20])
def test_encoders_a_leg_is_compared_with_readings_up_to_eight_ticks_old(leg, before):
    bench = after(before)
    bench.ticks(7, unseen=[leg])
    assert doubted(bench.tick(jump=six(1.0, leg)), Doubt.JUMP, leg, 1.0, 8.0 * CREEP)
    bench = after(before)
    bench.ticks(8, unseen=[leg])
    bench.ticks(2, jump=six(0.0))
    bench = after(before)
    bench.ticks(8, unseen=[leg])
    bench.ticks(1, jump=six(1.0, leg))
    assert doubted(bench.tick(jump=six(1.0, leg)), Doubt.JUMP, leg, 1.0, CREEP)
    bench = after(3, unseen=[2])
    bench.ticks(1)
    assert doubted(bench.tick(jump=six(1.0, 2)), Doubt.JUMP, 2, 1.0, CREEP)


def test_encoders_forget_earlier_readings_of_a_leg_after_a_long_silence():
    bench = after(1, rate=six(1.0), length_noise_m=1.0, rate_noise_m_s=1.0)
    bench.ticks(2, rate=six(1.0 + T), jump=six(0.01))
    names = ("gaps", "travel", "acceleration", "spacing_s")
    bench.tick(rate=six(1.0 + 2.0 * T), jump=six(0.01))
    assert all(bench.memory(name).all() for name in names)
    bench.ticks(9, unseen=range(6))
    bench.ticks(1)
    assert not any(bench.memory(name).any() for name in names)


# -- time


def test_encoders_do_not_count_lateness_known_from_the_clock_as_a_sampling_delay():
    bench = after(2, rate=RATES)
    for lateness in (0.25, 0.75, 0.0, 0.5):
        bench.ticks(1, lateness=lateness)
        assert bench.memory("delay_s") == pytest.approx(0.0, abs=1e-12)
    assert bench.memory("spacing_s") == pytest.approx(six(1.5 * T))


@ON_ONE_LEG
def test_encoders_do_not_count_lateness_known_from_the_bus_as_a_sampling_delay(leg):
    known = six(PERIOD_NS // 2, leg, other=0, dtype=int)
    for latch_ns, doubts in ((known, 0), (six(0, dtype=int), 1 << leg)):
        bench = after(3, rate=RATES)
        way = six(RATES[leg] * T / 2, leg)
        assert bench.tick(jump=way, latch_ns=latch_ns)["legs_doubted"] == doubts
        assert bench.tick(jump=-way)["legs_doubted"] == doubts


@BOTH_SIGNS
def test_encoders_count_a_delay_shown_by_all_legs_as_a_late_sampling_time(sign):
    bench = after(2, rate=sign * RATES)
    bench.ticks(1, late_s=0.75 * T, rate=sign * RATES + 1.75 * T)
    assert bench.memory("delay_s") == pytest.approx(0.75 * T, rel=1e-2)
    assert bench.memory("spacing_s") == pytest.approx(six(1.75 * T), rel=1e-2)
    assert bench.memory("acceleration") == pytest.approx(six(1.0), rel=1e-2)
    bench.ticks(1, late_s=0.75 * T)
    bench.ticks(1)
    assert bench.memory("delay_s") == pytest.approx(0.0, abs=1e-5)
    assert doubted(after(2, rate=RATES).tick(late_s=0.5 * T, jump=six(0.25, 2)), Doubt.JUMP, 2, 0.25, CREEP)


def test_encoders_apply_the_sampling_delay_of_the_other_legs_to_a_leg_that_was_silent():
    for late_s in (0.5 * T, 0.0):
        bench = after(2, rate=RATES)
        bench.ticks(1, late_s=0.5 * T, unseen=[5])
        bench.ticks(1, late_s=late_s)
        assert bench.memory("spacing_s")[5] == pytest.approx(2.0 * T + late_s)
        assert bench.memory("delay_s") == pytest.approx(late_s, abs=1e-12)
        bench.ticks(1)
        assert bench.memory("delay_s") == pytest.approx(0.0, abs=1e-12)
    bench = after(2, rate=RATES)
    bench.ticks(1, unseen=[5])
    tick = bench.tick(late_s=0.5 * T, jump=six(9.0, 5))
    assert doubted(tick, Doubt.JUMP, 5, 9.0, 2.0 * CREEP + 0.3 * T * 8.0)
    bench = after(2, rate=RATES)
    bench.ticks(1, unseen=range(6))
    bench.ticks(1, late_s=0.5 * T)
    assert bench.memory("delay_s") == pytest.approx(0.5 * T)


@BOTH_SIGNS
def test_encoders_allow_0_3_periods_of_lateness_to_a_leg_that_others_contradict(sign):
    """From -8 to -4 m/s, -6 m/s on average."""
    bench = after(2, rate=sign * RATES, disturbance_m_s2=256.0)
    limit = CREEP + 512.0 * T * T / 8.0 + 0.3 * T * 6.0
    tick = bench.tick(rate=sign * (RATES + six(4.0, 5)), jump=six(sign * 0.999 * limit, 5))
    assert calm(tick)
    bench = after(2, rate=sign * RATES, disturbance_m_s2=256.0)
    value = sign * 1.001 * limit
    tick = bench.tick(rate=sign * (RATES + six(4.0, 5)), jump=six(value, 5))
    assert doubted(tick, Doubt.JUMP, 5, value, limit)


@BOTH_SIGNS
@pytest.mark.parametrize("moving", [[5], [2, 5]])
def test_encoders_allow_one_period_of_lateness_if_only_few_legs_move(moving, sign):
    rates = sign * np.where(np.isin(np.arange(6), moving), RATES, 0.0)
    bench = after(2, rate=rates)
    bench.ticks(1, late_s=0.99 * T)
    bench.ticks(3)
    bench.ticks(1, late_s=0.99 * T)
    bench.ticks(1)
    tick = after(2, rate=rates).tick(late_s=1.01 * T)
    leg = moving[0]
    assert tick["legs_doubted"] == sum(1 << leg for leg in moving)
    assert tick["doubt_value"] == pytest.approx(1.01 * T * rates[leg])
    assert tick["doubt_limit"] == pytest.approx(T * abs(rates[leg]) + CREEP)


def test_encoders_check_a_late_leg_by_its_own_bound():
    """Forces widen the bound of leg 0 by 1 m; only leg 5 moves, and its answer is late by most of a period."""
    mobility = np.zeros((6, 6))
    mobility[0, 0] = 1.0
    bench = Bench(mobility=mobility, acting_ticks=3)
    bench.ticks(2, rate=six(-8.0, 5))
    bench.ticks(1, tau_asked=six(FORCE_N, 0))
    bench.ticks(1, late_s=0.99 * T)


@pytest.mark.parametrize("heard", [[5], [0, 5]])
def test_encoders_allow_one_period_of_lateness_if_only_few_legs_answer(heard):
    """A stall just before SYNC: only some answers arrive in time."""
    bench = after(2, rate=RATES)
    bench.ticks(1, late_s=0.9 * T, unseen=[leg for leg in range(6) if leg not in heard])
    bench.ticks(3)


def apart(leg, gap=0.5):
    """Columns of a tick in which the second encoder of a leg reads `gap` m more, twice its limit."""
    share = np.full(16, np.nan)
    share[LENGTH + leg] = 2.0
    gaps = six(gap, leg, np.nan)
    no_tracker = {"tracker_gap": np.full(6, np.nan)}
    return {"length_gap": gaps, "length_gap_now": gaps, "sensor_share": share} | no_tracker


@pytest.mark.parametrize("watched_legs", [63, 0])
@ON_ONE_LEG
def test_encoders_contradicted_by_the_second_encoder_of_the_leg_are_flagged_after_a_time(leg, watched_legs):
    limits = {"second_m": 0.25, "second_ticks": 3, "watched_legs": watched_legs}
    bench = Bench(second=STOPS, **limits)
    bench.ticks(2, **apart(leg))
    assert doubted(bench.tick(**apart(leg)), Doubt.EITHER, leg, 0.5, 0.25)
    assert bench.faults == Fault.ENCODER
    Bench(second=WARNS, **limits).ticks(9, **apart(leg))


def test_encoders_that_jump_are_flagged_for_the_jump_although_a_second_encoder_contradicts():
    bench = Bench(second=STOPS, second_m=0.25, second_ticks=3)
    bench.ticks(2, **apart(1))
    assert doubted(bench.tick(jump=six(9.0, 2), **apart(1)), Doubt.JUMP, 2, 9.0, CREEP)
    bench = Bench(second=STOPS, second_m=0.25, second_ticks=3)
    bench.ticks(2)
    assert doubted(bench.tick(jump=six(9.0, 2)), Doubt.JUMP, 2, 9.0, CREEP)
