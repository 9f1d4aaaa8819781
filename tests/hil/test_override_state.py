"""What the speed along a path keeps from tick to tick: where it was placed, begun, set at once, and asked to go."""

import numpy as np
import pytest

from hil.trajectory.override import Override, braking, change

T, CHANGE = 0.25, 2.0
"""s: with this period whole ticks are exact."""
LIMIT, STEP = 1.5 / CHANGE, 4.5 / CHANGE**2 * T


def test_path_time_begins_with_tick_zero_at_full_speed():
    override = Override(T, CHANGE)
    assert (override.time(0), override.time(4)) == (0.0, 1.0)
    assert override.full
    assert not override.resting


@pytest.mark.parametrize("sigma", [0.0, 0.5, 1.0])
def test_a_speed_that_is_set_at_once_goes_on_from_where_path_time_is(sigma):
    override = Override(T, CHANGE)
    override.begin(2)
    override.settle(6, 0.5)
    override.settle(10, sigma)
    assert [override.time(tick) for tick in (10, 12)] == [1.5, 1.5 + 0.5 * sigma]
    assert (override.sigma, override.target, override.dsigma) == (sigma, sigma, 0.0)
    assert override.settled
    assert override.full == (sigma == 1.0)
    assert override.resting == (sigma == 0.0)


def test_a_place_is_rested_at_until_it_is_asked_to_go_on():
    override = Override(T, CHANGE)
    override.place(8, 3.0)
    assert [override.time(tick) for tick in (8, 20)] == [3.0, 3.0]
    assert override.resting
    assert not override.full
    override.aim(20, 1.0)
    assert not override.resting, "it is asked to go on"
    override.advance(60)
    assert override.full
    assert override.time(61) == override.time(60) + T


def test_a_begin_puts_path_time_back_to_zero_whatever_it_was():
    override = Override(T, CHANGE)
    override.place(8, 3.0)
    override.begin(9)
    assert override.time(12) == 0.0
    override.settle(12, 1.0)
    assert override.time(16) == 1.0


def test_a_change_begins_with_the_tick_in_which_it_is_asked_for():
    override = Override(T, CHANGE)
    override.advance(8)
    assert override.time(8) == 2.0
    override.aim(8, 0.0)
    assert override.time(8) == 2.0
    override.advance(9)
    ds, sigma, dsigma = change(1.0, 0.0, 0.0, LIMIT, STEP, T)
    assert (override.time(9), override.sigma, override.dsigma) == (2.0 + ds, sigma, dsigma)
    assert 0.0 < ds < T
    override.aim(9, 0.0)
    override.advance(10)
    assert override.time(10) < 2.0 + 2 * T, "asked for again it goes on braking"


def test_a_speed_that_is_asked_for_and_passed_is_not_settled_and_no_rest():
    override = Override(T, CHANGE)
    for sigma, target, dsigma in ((1.0, 1.0, -0.1), (0.0, 0.0, 0.1), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)):
        override.sigma, override.target, override.dsigma = sigma, target, dsigma
        assert not override.settled
        assert not override.full
        assert not override.resting


@pytest.mark.parametrize("target", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("ticks", [0, 1, 3, 6])
def test_path_time_at_rest_is_where_one_more_tick_toward_the_target_and_then_braking_lead_to(target, ticks):
    override = Override(T, CHANGE)
    override.settle(0, 0.5)
    override.aim(0, 1.0)
    override.advance(ticks)
    foretold = override.rests_at(ticks, target)
    override.aim(ticks, target)
    override.advance(ticks + 1)
    override.aim(ticks + 1, 0.0)
    override.advance(ticks + 100)
    assert override.resting
    assert override.time(ticks + 100) == pytest.approx(foretold, abs=1e-12)


def test_braking_from_rest_takes_no_time_and_from_full_speed_half_of_what_it_lasts():
    assert braking(0.0, 0.0, LIMIT, STEP, T) == 0.0
    fine = 1e-3
    step = 4.5 / CHANGE**2 * fine
    assert braking(1.0, 0.0, LIMIT, step, fine) == pytest.approx(CHANGE / 2, abs=fine)
    rising = braking(0.5, LIMIT, LIMIT, step, fine)
    assert CHANGE / 4 < rising < CHANGE, "its rate has to fall first"


@pytest.mark.parametrize(
    ("sigma", "dsigma", "h", "ends", "advance"),
    [
        (0.5, 0.25, 1.0, 0.75, 0.625),
        (0.5, -0.25, 1.0, 0.25, 0.375),
        (0.5, 0.25, 4.0, 1.0, 3.0),
        (0.5, -0.25, 4.0, 0.0, 1.0),
        (1.0, 0.0, 2.0, 1.0, 2.0),
    ],
)
def test_the_look_ahead_goes_on_at_the_present_rate_up_to_full_speed_and_down_to_rest(
    sigma, dsigma, h, ends, advance
):
    override = Override(T, CHANGE)
    override.place(4, 3.0)
    override.sigma, override.dsigma = sigma, dsigma
    assert override.ahead(4, h) == (3.0 + advance, ends, dsigma)


@pytest.mark.parametrize("target", [0.1, 0.15, 0.2, 0.3, 0.37, 0.6, 0.7, 0.85, 0.9])
def test_a_change_ends_on_its_target_to_the_bit(target):
    override = Override(7e-3, 0.5)
    for tick, sigma in ((0, target), (200, 0.0), (400, target), (600, 1.0)):
        override.aim(tick, sigma)
        override.advance(tick + 199)
        assert override.sigma == sigma
        assert override.settled


@pytest.mark.parametrize(("sigma", "dsigma", "target"), [(0.4, 0.1, 1.0), (0.4, -0.1, 1.0), (0.4, 0.1, 0.0)])
def test_in_a_tick_the_rate_goes_evenly_to_its_end_and_path_time_is_the_integral_of_the_speed(
    sigma, dsigma, target
):
    ds, after, w = change(sigma, dsigma, target, LIMIT, 0.05, T)
    assert w == pytest.approx(dsigma + 0.05 * np.sign(target - sigma))
    assert after == pytest.approx(sigma + T * (dsigma + w) / 2, rel=1e-12)
    t = np.linspace(0.0, T, 10_001)
    speed = sigma + dsigma * t + (w - dsigma) * t**2 / (2 * T)
    assert ds == pytest.approx(np.trapezoid(speed, t), rel=1e-8)


@pytest.mark.parametrize(("sigma", "dsigma", "end"), [(0.99, 0.5, 1.0), (0.01, -0.5, 0.0)])
def test_a_speed_is_never_more_than_full_and_never_backward(sigma, dsigma, end):
    assert change(sigma, dsigma, end, LIMIT, 0.01, T)[1] == end


def test_at_no_speed_yet_a_rate_takes_the_path_on_before_it_is_braked():
    assert braking(0.0, 0.1, LIMIT, STEP, T) > 0.0


@pytest.mark.parametrize("off", [3e-13, -3e-13, 0.0])
@pytest.mark.parametrize("dsigma", [0.01, -0.01])
def test_a_speed_within_rounding_of_its_target_is_put_on_it_to_the_bit(off, dsigma):
    target = 0.4 + 0.5 * T * dsigma + off
    assert change(0.4, dsigma, target, LIMIT, STEP, T)[1:] == (target, 0.0)
