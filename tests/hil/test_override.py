"""The speed along a path: its bounds, its continuity, and that path time is its integral."""

import numpy as np
import pytest

from hil.loop.motion import Motion
from hil.trajectory.live import LiveTrajectory
from hil.trajectory.override import Override
from hil.trajectory.piecewise import PiecewisePolynomial
from tests.judged import ANYWHERE

T, CHANGE = 1e-3, 0.5


def course(targets, ticks, override=None):
    """Path time, sigma and its rate (n, 3) of each tick; targets by tick."""
    override = override or Override(T, CHANGE)
    found = []
    for tick in range(ticks):
        override.advance(tick)
        if tick in targets:
            override.aim(tick, targets[tick])
        found.append((override.time(tick), override.sigma, override.dsigma))
    return np.array(found)


def test_a_hold_takes_the_time_of_a_controlled_stop_and_half_of_it_goes_by_on_the_path():
    s, sigma, dsigma = course({100: 0.0}, 700).T
    rests = int(np.flatnonzero(sigma == 0.0)[0])
    assert rests - 100 == pytest.approx(CHANGE / T, abs=1)
    assert s[-1] - s[100] == pytest.approx(CHANGE / 2, abs=T / 2)
    assert (s[rests:] == s[-1]).all()
    assert dsigma.min() == pytest.approx(-1.5 / CHANGE, rel=1e-9)


def test_sigma_is_the_trapezoid_that_its_two_bounds_allow():
    """A rate that falls in T/3, stays for T/3 and rises in T/3: sigma(T/3) = 1 - 4.5 (T/3)^2/(2 T^2) = 3/4."""
    _, sigma, _ = course({0: 0.0}, 600).T
    assert sigma[167] == pytest.approx(0.75, abs=4e-3)
    assert sigma[250] == pytest.approx(0.5, abs=4e-3)
    assert sigma[333] == pytest.approx(0.25, abs=4e-3)


@pytest.mark.parametrize("seed", range(20))
def test_whatever_is_asked_for_the_bounds_hold_and_each_is_the_integral_of_the_next(seed):
    rng = np.random.default_rng(seed)
    targets = {int(t): float(rng.choice([0.0, 1.0, rng.random()])) for t in rng.integers(0, 3000, 25)}
    s, sigma, dsigma = course(targets, 4000).T
    assert sigma.min() >= 0.0
    assert sigma.max() <= 1.0
    assert np.abs(dsigma).max() <= 1.5 / CHANGE * (1 + 1e-9)
    assert np.abs(np.diff(dsigma)).max() <= 4.5 / CHANGE**2 * T * (1 + 1e-9)
    np.testing.assert_allclose(np.diff(sigma), T * (dsigma[1:] + dsigma[:-1]) / 2, atol=1e-11)
    # Simpson's rule is exact for the parabola between two ticks; its middle value follows from both ends
    middle = (sigma[1:] + sigma[:-1]) / 2 + T * (dsigma[:-1] - dsigma[1:]) / 8
    np.testing.assert_allclose(np.diff(s), T * (sigma[1:] + 4 * middle + sigma[:-1]) / 6, atol=1e-11)
    assert sigma[-1] == targets[max(targets)]


def test_skipped_ticks_are_made_up_for():
    override = Override(T, CHANGE)
    override.aim(10, 0.3)
    override.advance(777)
    whole = course({10: 0.3}, 778)[-1]
    assert (override.time(777), override.sigma, override.dsigma) == tuple(whole)


def test_at_full_speed_path_time_is_that_of_the_clock_to_the_bit():
    override = Override(T, CHANGE)
    override.begin(1208)
    assert all(override.time(tick) == (tick - 1208) * T for tick in range(1208, 30_000, 7))


def wave():
    """x = 0.2 t^3 - 0.05 t^4 for 3 s: nothing about it is constant."""
    coefficients = np.zeros((1, 6, 6))
    coefficients[0, 3, 0], coefficients[0, 4, 0] = 0.2 * 27, -0.05 * 81
    return PiecewisePolynomial(np.array([0.0, 3.0]), coefficients)


def test_the_motion_is_that_of_the_slowed_path_by_finite_differences():
    motion = Motion(T, np.zeros(3), np.eye(3), CHANGE)
    motion.start(wave(), 0)
    speeds = {300: (0.0, True), 900: (0.4, True), 1300: (1.0, True), 1450: (1.0, False), 1600: (0.7, True)}
    x, v, a, along = [], [], [], []
    for tick in range(2500):
        motion.advance(tick)
        if tick in speeds:
            motion.aim(tick, speeds[tick][0], go=speeds[tick][1])
        sample = motion.sample(tick)
        x.append(sample.p[0])
        v.append(sample.twist[0])
        a.append(sample.dtwist[0])
        along.append(motion.time(tick))
    s = np.array(along)
    np.testing.assert_allclose(x, 0.2 * s**3 - 0.05 * s**4, atol=1e-12)
    np.testing.assert_allclose(np.gradient(x, T)[1:-1], v[1:-1], atol=1e-5)
    np.testing.assert_allclose(np.gradient(v, T)[1:-1], a[1:-1], atol=1e-2)
    assert np.abs(np.diff(a)).max() < 0.05
    top, hardest = np.abs(0.6 * s**2 - 0.2 * s**3).max(), np.abs(1.2 * s - 0.6 * s**2).max()
    assert np.abs(v).max() <= top
    assert np.abs(a).max() <= hardest + 1.5 / CHANGE * top


@pytest.mark.parametrize("asked", [(200, 0.0), (500, 0.25), (260, 1.0)])
def test_a_stop_from_less_than_full_speed_rests_soon_and_then_is_finished(asked):
    motion = Motion(T, np.zeros(3), np.eye(3), CHANGE)
    motion.start(wave(), 0)
    motion.aim(0, 0.25, go=True)
    for tick in range(2000):
        motion.advance(tick)
        if tick == asked[0]:
            motion.aim(tick, asked[1], go=True)
        if tick == 520:
            motion.stop(tick, CHANGE)
        if tick >= 520 and motion.finished(tick):
            break
    assert 520 <= tick <= 520 + 4 / 3 * CHANGE / T + 1
    assert not motion.sample(tick).twist.any()
    assert not motion.overdue(tick + 999, 1.0)
    assert motion.overdue(tick + 1001, 1.0)
    assert motion.sample(tick + 5000).p[0] == motion.sample(tick).p[0]


START = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
FAR, NEAR = np.array([0.6, *START[1:]]), np.array([0.3, *START[1:]])
LIMITS = np.array([[0.3] * 6, [1.0] * 6, [10.0] * 6])


def followed(live, ticks, asked):
    found = []
    for tick in range(ticks):
        live.advance(tick, ANYWHERE)
        for act in asked.get(tick, ()):
            act()
        sample = live.sample(0.0)
        found.append((sample.p[0], sample.twist[0], sample.dtwist[0]))
    return np.array(found).T


def test_a_live_reference_slows_down_within_its_limits_and_speeds_up_again():
    live = LiveTrajectory(START, LIMITS, T)
    x, v, a = followed(
        live,
        6000,
        {1: [lambda: live.aim(FAR)], 900: [lambda: live.limit(0.2)], 2000: [lambda: live.limit(1.0)]},
    )
    assert v[850] == pytest.approx(0.3)
    np.testing.assert_allclose(v[1500:2000], 0.06, atol=1e-12)
    assert v[2600:2700].max() == pytest.approx(0.3)
    assert np.abs(a).max() <= 1.0 + 1e-9
    assert np.abs(np.diff(a)).max() <= 10.0 * T * (1 + 1e-9)
    assert x[-1] == pytest.approx(0.6, abs=1e-12)


def test_a_live_reference_on_hold_rests_and_goes_on_with_the_next_set_point_only():
    live = LiveTrajectory(START, LIMITS, T)
    x, v, a = followed(
        live,
        4000,
        {
            1: [lambda: live.aim(FAR)],
            900: [live.halt],
            2500: [lambda: live.aim(NEAR)],
        },
    )
    assert (v[1700:2500] == 0).all()
    assert 0.1 < x[2400] < 0.4
    assert np.abs(np.diff(a)).max() <= 10.0 * T * (1 + 1e-9)
    assert x[-1] == pytest.approx(0.3, abs=1e-12)
