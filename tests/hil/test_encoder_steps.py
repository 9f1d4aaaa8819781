"""Rules on encoders with unequal ticks: long and short steps, late latches, silences, pushes."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from drivers.signals import Doubt, Warn
from hil.safety import residuals
from hil.safety.certificate import CONSTANTS, Watch
from hil.safety.encoder_limits import NONE
from tests.hil.encoder_bench import BOTH_SIGNS, CREEP, ON_ONE_LEG, RATES, Bench, T, after, calm, doubted, six
from tests.hil.safety_bench import Bench as Guarded
from tests.hil.safety_bench import certified

STEPS = pytest.mark.parametrize(
    ("T0", "T1"), [(1.0, 1.0), (1.0, 1.5), (1.5, 0.5), (3.0, 1.0), (1.0, 3.0)], ids=str
)
"""Previous step and last step."""


@STEPS
def test_residuals_lag_of_a_differentiated_rate_is_the_worst_case_of_an_acceleration(T0, T1):
    """Slope of the parabola through three lengths minus the rate at their end, summed over force pulses."""
    pulse = (T0 + T1) * 1e-4
    at = np.arange(-T0 - T1, 0.0, pulse) + 0.5 * pulse
    lengths = [np.zeros_like(at), np.clip(-T1 - at, 0.0, None) * pulse, -at * pulse]
    last, before = (lengths[2] - lengths[1]) / T1, (lengths[1] - lengths[0]) / T0
    wrong = last + (last - before) * T1 / (T0 + T1) - pulse
    assert abs(wrong.sum()) < 1e-3, "a uniform acceleration must give no error of the rate"
    assert residuals.lag_of(T1, T0) == pytest.approx(np.clip(wrong, 0.0, None).sum(), rel=1e-3)


@STEPS
def test_residuals_lag_of_a_rate_jump_weights_the_lags_of_its_three_rates(T0, T1):
    """With rates r0, r1, r2 the leap is r2 - r1 - (r1 - r0) T1 / T0; r0 and r1 have the same lag."""
    lags = 0.25, 0.125
    counts = 1.0, 1.0 + T1 / T0, T1 / T0
    expected = lags[0] * counts[0] + lags[1] * (counts[1] + counts[2])
    assert residuals.lag_of_leap(*lags, T1, T0) == pytest.approx(expected)


LAG = {(1.0, 1.0): 1.0 / 3.0, (1.0, 1.5): 0.5 * 1.5 * 2.5 / 4.0, (1.5, 0.5): 0.5 * 0.5 * 2.0 / 2.5}
"""Periods, by previous step and last step."""


@ON_ONE_LEG
@BOTH_SIGNS
@pytest.mark.parametrize("after_it", [False, True], ids=["in a long step", "in the short one after it"])
def test_bound_on_a_jump_of_differentiated_rates_accounts_for_unequal_steps(leg, sign, after_it):
    """The acceleration range is 16 m/s^2. A tick half a period late makes steps of 1.5 T and 0.5 T."""
    if after_it:
        step, lags = 0.5, LAG[1.5, 0.5] + LAG[1.0, 1.5] * (1.0 + 2.0 * 0.5 / 1.5)
    else:
        step, lags = 1.5, LAG[1.0, 1.5] + LAG[1.0, 1.0] * (1.0 + 2.0 * 1.5)
    limit = 16.0 * T * (step + lags)
    for share, doubts in ((0.999, False), (1.001, True)):
        bench = after(6, differences=1, disturbance_m_s2=8.0, length_noise_m=1e3, open_ticks=2)
        if after_it:
            bench.ticks(1, lateness=0.5)
        leap = sign * share * limit
        tick = bench.tick(rate=six(leap, leg), lateness=0.0 if after_it else 0.5)
        assert doubted(tick, Doubt.LEAP, leg, leap, limit) if doubts else calm(tick)


def slopes(lengths):
    """Slope at the end of the parabola through each three lengths, spaced by 1."""
    return 1.5 * lengths[2:] - 2.0 * lengths[1:-1] + 0.5 * lengths[:-2]


def test_residuals_factors_of_a_late_sample_and_a_length_jump_in_differentiated_rates_are_exact():
    """Lengths at 1 m/s, spaced by 1 s; a leap is a slope's deviation from the last two, extrapolated."""
    even, delay, jump = np.arange(12.0), 0.01, 0.01
    late = even + delay * (np.arange(12) == 6)
    leaps = np.diff(slopes(late), n=2)
    assert np.abs(leaps).max() == pytest.approx(residuals.TIME_LEAPS * delay)
    np.testing.assert_allclose(leaps[2:7] / delay, [1.5, -5.0, 6.0, -3.0, 0.5], atol=1e-9)
    jumped = even + jump * (np.arange(12) >= 6)
    leap = np.diff(slopes(jumped), n=2)[2]
    assert leap == pytest.approx(residuals.SHOWS_AS_LEAP * jump)
    gaps = np.diff(jumped)[2:] - 0.5 * (slopes(jumped)[1:] + slopes(jumped)[:-1])
    assert gaps[3] == pytest.approx(residuals.SHOWS_AS_GAP * jump)


@pytest.mark.parametrize("leg", range(6))
@BOTH_SIGNS
def test_residuals_late_sample_explains_a_rate_jump_of_either_sign(leg, sign):
    """The same delay of all moving legs; its largest leap is six times rate and delay."""
    rates, bounds = sign * RATES, six(1e-3)
    for share, is_time in ((0.99, True), (1.01, False)):
        leaps = share * residuals.TIME_LEAPS * 0.25 * rates
        assert bool(residuals.is_time(leg, leaps, rates, bounds, 0.25)) == is_time
    alone = six(1.0, leg)
    assert not residuals.is_time(leg, alone, rates, bounds, 0.25), "the other legs show no delay"


def test_residuals_differentiated_rate_lags_by_half_its_step_after_an_unknown_step():
    assert residuals.lag_of(4.0, 0.0) == 2.0


@pytest.mark.parametrize("leg", range(6))
@BOTH_SIGNS
def test_residuals_rate_jump_counts_as_a_late_sample_within_the_bound_of_its_leg(leg, sign):
    """Six times 0.25 periods of each rate are explained exactly, plus the leg's own bound."""
    is_time = residuals.is_time
    leaps = sign * 1.5 * RATES
    assert is_time(leg, leaps, RATES, six(0.0), 0.25)
    more = leaps + np.sign(leaps) * six(0.5, leg)
    assert is_time(leg, more, RATES, six(0.51, leg), 0.25)
    assert not is_time(leg, more, RATES, six(0.49, leg), 0.25)
    for unknown in range(6):
        some = leaps + six(np.nan, unknown)
        assert is_time(leg, some, RATES, six(0.0), 0.25) == (unknown != leg)


@pytest.mark.parametrize("leg", range(6))
@pytest.mark.parametrize("silent", [0, 2, 5])
def test_bounds_on_length_changes_and_rate_jumps_use_the_time_steps_of_their_own_leg(leg, silent):
    """The acceleration range is 16 m/s^2; the silent leg has a step of 2 T behind it, the others T."""
    steps = (1.0, 2.0, 1.0) if leg == silent else (1.0, 1.0, 1.0)
    lags = [0.5 * now * (now + was) / (2.0 * now + was) for was, now in pairwise(steps)]
    gap = 16.0 * T * T * (1.0 / 8.0 + 0.5 * sum(lags)) + CREEP
    was, lags = (2.0, [0.375, 0.6]) if leg == silent else (1.0, [1.0 / 3.0, 1.0 / 3.0])
    leap = 16.0 * T * (1.0 + lags[0] + lags[1] * (1.0 + 2.0 / was))
    for noise_m, change, expected in (
        (0.0, {"jump": six(1.0, leg)}, (Doubt.JUMP, leg, 1.0, gap)),
        (1e3, {"rate": six(9.0, leg)}, (Doubt.LEAP, leg, 9.0, leap)),
    ):
        bench = after(6, differences=1, disturbance_m_s2=8.0, length_noise_m=noise_m, open_ticks=2)
        bench.ticks(1, unseen=[silent])
        bench.ticks(1)
        assert doubted(bench.tick(**change), *expected)


@ON_ONE_LEG
def test_first_rate_after_a_long_silence_is_not_checked_for_a_rate_jump(leg):
    bench = after(3, open_ticks=0, length_noise_m=1e3, rate_noise_m_s=1e-3)
    bench.ticks(9, unseen=[leg])
    bench.ticks(1)
    bench.ticks(1, rate=six(9.0, leg))
    assert doubted(bench.tick(rate=six(0.0)), Doubt.LEAP, leg, -18.0, 4e-3)


FASTEST = 5
"""Fastest of RATES, at 8 m/s; the next one has 4 m/s."""


@pytest.mark.parametrize("leg", range(6))
@BOTH_SIGNS
@pytest.mark.parametrize("unshared", [0.3, 0.6])
def test_fastest_leg_is_not_flagged_for_a_sampling_delay_common_to_all_legs(leg, sign, unshared):
    """All slopes leap by the same share of their rates; only the fastest leaps by more than forces explain."""
    bound = 16.0 * T * (1.0 + 4.0 / 3.0)
    largest = bound + residuals.TIME_LEAPS * unshared * 8.0
    for leap, doubts in ((1.1 * bound, False), (1.9 * bound, False), (1.01 * largest, True)):
        rates = sign * np.roll(RATES, leg - FASTEST)
        bench = Bench(
            differences=1, disturbance_m_s2=8.0, length_noise_m=1e3, open_ticks=2, unshared=unshared
        )
        bench.ticks(8, rate=rates)
        late = np.abs(rates) / 8.0 * leap
        if doubts:
            late = np.minimum(late, 0.9 * bound) + six(0.0)
            late[leg] = leap
        tick = bench.tick(rate=rates + np.sign(rates) * late)
        if doubts:
            assert doubted(tick, Doubt.LEAP, leg, np.sign(rates[leg]) * leap, bound)
        else:
            assert calm(tick)


def test_length_change_allowed_after_a_stall_is_cleared_by_a_long_silence():
    bench = after(2, disturbance_m_s2=64.0, length_noise_m=1e-3)
    bench.ticks(3, unseen=[1])
    bench.ticks(1, jump=six(0.05, 1))
    assert bench.memory("excused")[1] > 0.04
    bench.ticks(9, unseen=[1])
    bench.ticks(1)
    assert bench.memory("excused")[1] == 0.0
    calm_until_now = Bench(disturbance_m_s2=64.0, length_noise_m=1e-3)
    calm_until_now.ticks(2)
    just_allowed = 0.99 * (2e-3 + 128.0 * T * T / 8.0 + CREEP)
    doubts = [
        [int(each.tick(jump=six(just_allowed, 1))["doubt"]) for _ in range(12)]
        for each in (bench, calm_until_now)
    ]
    assert doubts[0] == doubts[1]
    assert doubts[0][-1] == Doubt.SLIP, "a slip is found as soon as if there had been no stall"


@pytest.mark.parametrize("pushes", [True, False])
def test_lyapunov_certificate_is_not_checked_while_a_leg_with_frozen_encoder_is_pushed(pushes):
    """The monitor of `certified` with three efforts; one leg has a frozen reading 0.2 m off its reference."""
    watch = Watch(certified().safety._watched[:CONSTANTS].copy(), 3)
    legs = 0b111111 if pushes else 0
    limits = NONE._replace(watched_legs=legs, length_noise_m=0.01, push_N=np.full(6, 8.0), push_ticks=3)
    bench = Guarded(watch=watch, encoders=limits)
    bench.tick(q_d=5.0)
    bench.tick(q_d=5.0)
    verdicts = [bench.tick(q_d=six(5.2, 3, 5.0)) for _ in range(5)]
    assert any(v.tau[3] != 0.0 for v in verdicts) == pushes
    assert not any(v.warnings & Warn.FORCE_STEP for v in verdicts)
    judged = [bool(np.isfinite(v.certificate[2])) for v in verdicts]
    assert judged == [True, *[not pushes] * 4]


@pytest.mark.parametrize("other", [0, 2, 4])
def test_leg_with_an_unknown_rate_jump_does_not_contradict_a_late_sample(other):
    """The leg was silent for long and has answered once since: its spacing is unknown."""
    bench = after(8, rate=RATES, differences=1, disturbance_m_s2=8.0, length_noise_m=1e3, open_ticks=2)
    bench.ticks(9, unseen=[other])
    bench.ticks(1)
    leap = 1.1 * 16.0 * T * (1.0 + 4.0 / 3.0) * RATES / 8.0
    assert calm(bench.tick(rate=RATES + leap))


@pytest.mark.parametrize("leg", range(6))
@BOTH_SIGNS
def test_leg_that_moves_alone_may_have_a_rate_jump_of_a_late_sample_plus_forces(leg, sign):
    bound = 16.0 * T * (1.0 + 4.0 / 3.0)
    largest = bound + residuals.TIME_LEAPS * 0.3 * 8.0
    for share, doubts in ((0.99, False), (1.01, True)):
        bench = after(
            8,
            rate=six(sign * 8.0, leg),
            differences=1,
            disturbance_m_s2=8.0,
            length_noise_m=1e3,
            open_ticks=2,
        )
        tick = bench.tick(rate=six(sign * (8.0 + share * largest), leg))
        assert tick["doubt"] == (Doubt.LEAP if doubts else Doubt.NONE)


@pytest.mark.parametrize("leg", range(6))
def test_stall_allows_the_length_change_beyond_noise_and_a_share_of_the_travel(leg):
    rates = RATES / 16.0
    bench = after(2, rate=rates, disturbance_m_s2=64.0, length_noise_m=1e-3, rate_error=0.125)
    bench.ticks(3, unseen=[leg])
    bench.ticks(1, jump=six(0.05, leg))
    expected = 0.05 - 2e-3 - 0.125 * 4.0 * T * abs(rates[leg])
    assert bench.memory("excused")[leg] == pytest.approx(expected, rel=1e-9)


@BOTH_SIGNS
@pytest.mark.parametrize(("leap", "doubts"), [(0.9e-9, False), (1.1e-9, True)])
def test_rate_jumps_up_to_1_nm_per_s_are_always_allowed(leap, doubts, sign):
    tick = after(4, open_ticks=0).tick(rate=six(sign * leap, 2))
    assert doubted(tick, Doubt.LEAP, 2, sign * leap, 1e-9) if doubts else calm(tick)
