"""Every rule on encoders on both sides of its limit.

Test names begin with the file of the rules: the mutation test runs them against mutated copies of that file.
"""

import math

import numpy as np
import pytest

from hil.loop.probe import push_of
from hil.safety import residuals

ON_ONE_LEG = pytest.mark.parametrize("leg", range(6))
BOTH_SIGNS = pytest.mark.parametrize("sign", [1, -1])
BARELY = 1e-9


def six(value, leg=None, other=0.0):
    """Six times `value`, or six `other` with `value` on one leg."""
    x = np.full(6, float(value if leg is None else other))
    if leg is not None:
        x[leg] = value
    return x


# -- latch

RATES = np.array([0.5, -1.0, 2.0, -4.0, 8.0, 0.25])


UNLIKE = np.array([1.0, -1.5, 2.0, -1.25, 1.0, 1.75])
ALIKE = np.array([1.0, -1.0, 1.0, -1.0, 1.0, 1.0])
TWO, THREE = six(1.0) * ([1.0] * 2 + [0.0] * 4), six(1.0) * ([1.0] * 3 + [0.0] * 3)
FAST = np.array([4.0, 4.0, 1.0, 0.0, 0.0, 0.0])
MIDDLE = [0.2, 0.21, 0.27, 0.28, math.nan, 0.25]
SMALL = 1e-6


def on(*legs):
    return 1.0 * np.isin(np.arange(6), legs)


SHARED = [
    # all legs show it; one or two that are off do not change what the others agree on
    *[(sign * 0.5 * RATES, RATES, SMALL, sign * 0.5) for sign in (1, -1)],
    *[(0.25 * UNLIKE + six(way, leg), UNLIKE, SMALL, 0.25) for leg in range(6) for way in (3.0, -3.0)],
    *[(0.25 * ALIKE + on(a) - 2.0 * on(b), ALIKE, SMALL, 0.25) for a, b in ((0, 1), (2, 4), (1, 5))],
    # a jump at rest or of the only leg that moves is none, and a leg that is not heard has no say
    *[(5e-3 * on(leg), rate * on(leg), SMALL, None) for leg in range(6) for rate in (0.0, 1.0)],
    *[(0.25 * RATES + six(math.nan, leg), RATES, SMALL, 0.25) for leg in range(6)],
    (six(math.nan), RATES, SMALL, None),
    # the leg in the middle counts, and of two delays that are as good the first
    *[(np.roll(MIDDLE, shift), six(1.0), 0.06, 0.25) for shift in range(6)],
    (np.array([0.25] * 3 + [0.5] * 3), six(1.0), SMALL, 0.25),
    # any three legs bear witness, each by more than its tolerance, and agree within it
    *[(0.5 * on(*legs), on(*legs), 0.25, 0.5) for legs in ((0, 1, 2), (3, 4, 5), (0, 2, 5))],
    (0.5 * THREE, THREE, 0.5, None),
    (0.5 * TWO, TWO, 0.25, None),
    *[(np.array([2.0, 2.0, gap, 0.0, 0.0, 0.0]), FAST, 0.25, 0.5) for gap in (0.25, 0.75)],
    *[(np.array([2.0, 2.0, gap, 0.0, 0.0, 0.0]), FAST, 0.2499, None) for gap in (0.25, 0.75)],
    # two legs at one speed, one of them off: a delay explains it no better than a jump
    (0.5 * on(0), TWO, SMALL, None),
]


@pytest.mark.parametrize(("gap", "rates", "tolerance", "delay"), SHARED)
def test_residuals_shared_sampling_delay_needs_three_legs_that_show_it(gap, rates, tolerance, delay):
    expected = (0.0, False) if delay is None else (delay, True)
    assert residuals.shared_delay(gap, rates, six(tolerance)) == expected


@ON_ONE_LEG
@BOTH_SIGNS
def test_residuals_sampling_delay_of_one_leg_is_possible_unless_other_legs_contradict(leg, sign):
    """At 1 m/s half a metre is half a second; the others show the same, rest, or are silent."""
    gap, rates, tolerance = six(sign * 0.5, leg), six(1.0, leg), six(1e-6)
    say = six(math.nan)
    assert residuals.explained(leg, gap, rates, tolerance, say), "no other leg reports"
    assert residuals.explained(leg, gap, rates, tolerance, six(sign * 0.5, leg)), "the other legs are at rest"
    other = (leg + 2) % 6
    rates[other] = -2.0
    say[other] = sign * -1.0
    assert residuals.explained(leg, gap, rates, tolerance, say)
    say[other] = sign * 1.0
    assert not residuals.explained(leg, gap, rates, tolerance, say)
    say[other] = 0.0
    assert not residuals.explained(leg, gap, rates, tolerance, say)


@BOTH_SIGNS
@pytest.mark.parametrize("way", [1, -1])
def test_residuals_two_legs_contradict_on_a_sampling_delay_only_beyond_both_tolerances(sign, way):
    """Half a second is 1 m at 2 m/s, and 4 m at 8 m/s: 1/8 m of the one corresponds to 1/2 m of the other."""
    rates = np.array([way * 2.0, sign * 8.0, 0.0, 0.0, 0.0, 0.0])
    tolerance = np.array([0.125, 0.25, 1.0, 1.0, 1.0, 1.0])
    gap, say = six(way * 1.0, 0), six(math.nan)
    for off in (-0.75, 0.75):
        say[1] = sign * 4.0 + off
        assert residuals.explained(0, gap, rates, tolerance, say)
        say[1] = sign * 4.0 + 1.01 * off
        assert not residuals.explained(0, gap, rates, tolerance, say)


@pytest.mark.parametrize(("moving", "shared"), [((1, 3, 4), True), ((0, 3, 5), True), ((0, 1), False)])
def test_residuals_leg_shows_a_sampling_delay_only_beyond_its_tolerance(moving, shared):
    tolerance = np.where(np.isin(np.arange(6), moving), 1e-6, 9.0)
    assert residuals.shared_delay(RATES * 0.25, RATES, tolerance)[1] == shared


@pytest.mark.parametrize("exact", [(0, 4), (3, 4)])
def test_residuals_leg_agrees_with_a_shared_sampling_delay_within_its_tolerance(exact):
    """The two fast legs determine the delay; the others differ by less than their tolerance."""
    those = np.isin(np.arange(6), exact)
    rates = np.where(those, 8.0, 1.0)
    gap, tolerance = np.where(those, 2.0, 0.26), np.where(those, 1e-6, 0.02)
    assert residuals.shared_delay(gap, rates, tolerance) == (0.25, True)
    assert not residuals.shared_delay(gap, rates, six(1e-6))[1]


@ON_ONE_LEG
@BOTH_SIGNS
@pytest.mark.parametrize("of", ["itself", "another"])
def test_residuals_sampling_delay_explains_a_leg_within_the_tolerance_of_each_leg(leg, sign, of):
    explained = residuals.explained
    off = leg if of == "itself" else (leg + 2) % 6
    for wrong, fine in ((0.09, True), (0.11, False)):
        gap = RATES * 0.25
        say = gap + six(sign * wrong, off)
        gap[leg] = say[leg]
        assert explained(leg, gap, RATES, six(0.1, off), say) == fine


# -- increments


@pytest.mark.parametrize("sign", [1, -1])
def test_residuals_rate_jump_explains_a_length_change_of_up_to_half_jump_times_period(sign):
    """From 2 m/s to rest at the beginning or end of half a second: 0 or 1 m; the rates give half a metre."""
    T, leap = 0.5, -2.0
    for gap in (0.5, -0.5):
        assert residuals.beside(sign * gap, sign * leap, T) == 0.0
    assert residuals.beside(sign * 0.75, leap, T) == sign * 0.25
    assert residuals.beside(sign * 0.75, -leap, T) == sign * 0.25
    assert residuals.beside(sign * 0.25, leap, T) == 0.0
    assert residuals.beside(sign * 0.25, 0.0, T) == sign * 0.25


def test_residuals_length_change_bound_is_the_worst_case_of_an_acceleration():
    """An acceleration that changes by a half-way gives the trapezoidal rule an error of a T^2 / 8."""
    a, T = 16.0, 1e-3
    v = 0.5 * a * T
    length = 0.5 * a * (0.5 * T) ** 2  # rest, then a
    assert abs(length - 0.5 * T * v) == pytest.approx(a * T * T / 8)
    rest = 0.02 * T / 2
    assert residuals.gap_bound(0.0, 0.0, a, T) == pytest.approx(a * T * T / 8 + rest)


def test_residuals_length_change_bound_includes_noise_and_a_creeping_leg():
    assert residuals.gap_bound(3.0, 0.0, 0.0, 0.0) == 6.0
    assert residuals.gap_bound(0.0, 5.0, 0.0, 0.5) == 2.5 + 0.02 * 0.25
    assert residuals.gap_bound(0.0, 0.0, 8.0, 0.5) == 0.25 + 0.02 * 0.25


def test_residuals_slip_bound_of_a_window_adds_noise_rate_acceleration_and_scale_errors():
    T, rest = 1e-3, 0.02 * 0.5e-3
    assert residuals.slip_bound(3.0, 0.0, 0.0, T, 0.0, 0.0) == pytest.approx(6.0 + rest)
    assert residuals.slip_bound(0.0, 2.0, 0.0, T, 0.0, 0.0) == pytest.approx(0.1 + rest)
    assert residuals.slip_bound(0.0, 0.0, 8.0, T, 0.0, 0.0) == pytest.approx(4.0 * T * T + rest)
    assert residuals.slip_bound(0.0, 0.0, 0.0, T, 0.25, 4.0) == pytest.approx(1.0 + rest)
    assert residuals.slip_bound(0.0, 2.0, 0.0, 0.5, 0.0, 0.0) == pytest.approx(1.0 + 0.02 * 0.25)


@BOTH_SIGNS
def test_residuals_long_tick_allows_the_part_of_a_length_change_beyond_noise_and_scale(sign):
    assert residuals.excused(1.0, sign * 5.0, 2.0, 0.5, 0.25) == 3.0
    assert residuals.excused(4.0, sign * 5.0, 2.0, 0.5, 0.25) == 4.0
    assert residuals.excused(1.0, sign * 5.0, 2.0, 0.376, 0.25) == 3.0
    assert residuals.excused(1.0, sign * 5.0, 2.0, 0.375, 0.25) == 1.0
    assert residuals.excused(0.0, sign * 1.0, 2.0, 0.5, 0.25) == 0.0, "a step without excess allows nothing"


# -- leaps


@ON_ONE_LEG
def test_residuals_rate_jump_bound_includes_disturbance_and_force_changes(leg):
    mobility = np.zeros((6, 6))
    mobility[leg] = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]
    assert residuals.acceleration_range(mobility, six(0.5), 4.0, leg) == 8.0 + 10.5
    assert residuals.acceleration_range(mobility, six(2.0, 5), 0.0, leg) == 12.0
    assert residuals.acceleration_range(mobility, six(2.0), 4.0, (leg + 1) % 6) == 8.0


def test_residuals_rate_jump_bound_includes_acceleration_and_noise():
    assert residuals.leap_bound(0.0, 8.0, 0.25, 0.25) == 2.0
    assert residuals.leap_bound(1.0, 0.0, 0.25, 0.25) == 4.0
    assert residuals.leap_bound(1.0, 0.0, 0.5, 0.25) == 6.0


@ON_ONE_LEG
def test_residuals_rate_jump_is_attributed_to_a_leg_only_if_no_other_leg_has_one(leg):
    assert residuals.sole(six(1.0)) == -1
    assert residuals.sole(six(1.0 + BARELY, leg, 1.0)) == leg
    two = six(1.5, leg)
    two[(leg + 2) % 6] = 1.5
    assert residuals.sole(two) == -1
    assert residuals.sole(six(2.0)) == -1


# -- stillness


@ON_ONE_LEG
@BOTH_SIGNS
def test_residuals_distance_of_a_leg_counts_from_its_own_initial_error(leg, sign):
    began, heard = np.arange(1.0, 7.0), np.zeros(6, int)
    assert residuals.strayed(began, began, heard) == 0.0
    assert residuals.strayed(began + six(sign * 0.5, leg), began, heard) == 0.5


@BOTH_SIGNS
def test_residuals_leg_is_still_within_the_noise_of_length_and_rate(sign):
    assert residuals.stands(5.0 + sign * 0.25, 0.0, 5.0, 0.25, 0.5)
    assert not residuals.stands(5.0 + sign * 0.26, 0.0, 5.0, 0.25, 0.5)
    assert residuals.stands(5.0, sign * 0.5, 5.0, 0.25, 0.5)
    assert not residuals.stands(5.0, sign * 0.51, 5.0, 0.25, 0.5)


@ON_ONE_LEG
@BOTH_SIGNS
def test_residuals_still_leg_is_compared_with_the_farthest_leg_that_reports(leg, sign):
    heard, began = np.zeros(6, np.int64), six(0.5)
    assert residuals.strayed(six(0.5), began, heard) == 0.0
    assert residuals.strayed(six(0.5 + sign * 2.0, leg, 0.75), began, heard) == 2.0
    silent = heard.copy()
    silent[leg] = 1
    assert residuals.strayed(six(9.0, leg, 0.75), began, silent) == 0.25


@BOTH_SIGNS
def test_residuals_probe_push_has_both_directions_as_steps_or_ramps(sign):
    assert push_of(0, 5, 10.0, False, 1) == push_of(0, 5, 10.0, True, 1) == 0.0
    ticks = [sign * n for n in (1, 2, 5, 6, 10, 11)]
    lines = [sign * push_of(n, 5, 10.0, False, 1) for n in ticks]
    assert lines == [4.0, 8.0, 10.0, 6.0, -10.0, -10.0]
    assert [sign * push_of(n, 5, 10.0, True, 1) for n in ticks] == [10.0] * 3 + [-10.0] * 3
    assert [sign * push_of(sign * n, 11, 10.0, True, 4) for n in range(6)] == [0.0, 2.5, 5.0, 7.5, 10.0, 10.0]


def test_residuals_leg_counts_as_moving_from_20_um_on():
    """20 um, with an assumed noise of 2 um."""
    assert (residuals.SUSPECT, residuals.MOVED, residuals.SETTLES_S) == (10.0, 3.0, 0.2)
