"""Speed along a path: its bounds, its continuity, path time as its integral, and the state that it keeps."""

import numpy as np
import pytest

from hil.loop.motion import Motion
from hil.trajectory.override import Override
from hil.trajectory.piecewise import PiecewisePolynomial

T, CHANGE = 1e-3, 0.5


def course(targets, ticks):
    """Path time, sigma and its rate (n, 3) at each tick; targets by tick."""
    override, found = Override(T, CHANGE), []
    for tick in range(ticks):
        override.advance(tick)
        if tick in targets:
            override.aim(tick, targets[tick])
        found.append((override.time(tick), override.sigma, override.dsigma))
    return np.array(found)


def test_path_speed_falls_on_hold_with_a_trapezoidal_rate_within_the_stop_time():
    """The rate falls in T/3, stays for T/3 and rises in T/3: sigma(T/3) = 1 - 4.5 (T/3)^2/(2 T^2) = 3/4."""
    s, sigma, dsigma = course({100: 0.0}, 700).T
    rests = int(np.flatnonzero(sigma == 0.0)[0])
    assert rests - 100 == pytest.approx(CHANGE / T, abs=1)
    assert s[-1] - s[100] == pytest.approx(CHANGE / 2, abs=T / 2)
    assert (s[rests:] == s[-1]).all()
    assert dsigma.min() == pytest.approx(-1.5 / CHANGE, rel=1e-9)
    assert sigma[[267, 350, 433]] == pytest.approx([0.75, 0.5, 0.25], abs=4e-3)


@pytest.mark.parametrize("seed", range(3))
def test_path_speed_keeps_its_bounds_for_any_targets_and_integrates_exactly(seed):
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


def test_path_time_after_skipped_ticks_equals_path_time_without_skips():
    override = Override(T, CHANGE)
    override.aim(10, 0.3)
    override.advance(777)
    whole = course({10: 0.3}, 778)[-1]
    assert (override.time(777), override.sigma, override.dsigma) == tuple(whole)


def test_at_full_speed_path_time_equals_the_clock_to_the_bit():
    override = Override(T, CHANGE)
    override.begin(1208)
    assert all(override.time(tick) == (tick - 1208) * T for tick in range(1208, 30_000, 7))


def wave():
    """x = 0.2 t^3 - 0.05 t^4 for 3 s: a path without a constant derivative."""
    coefficients = np.zeros((1, 6, 6))
    coefficients[0, 3, 0], coefficients[0, 4, 0] = 0.2 * 27, -0.05 * 81
    return PiecewisePolynomial(np.array([0.0, 3.0]), coefficients)


def test_motion_of_a_slowed_path_agrees_with_finite_differences():
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


# -- what it keeps, with a period with which whole ticks are exact

LONG, SLOWLY = 0.25, 2.0
LIMIT, STEP = 1.5 / SLOWLY, 4.5 / SLOWLY**2 * LONG


def times(override, *ticks):
    return [override.time(tick) for tick in ticks]


@pytest.mark.parametrize("sigma", [0.0, 0.5, 1.0])
def test_path_speed_set_without_ramp_continues_from_the_present_path_time(sigma):
    override = Override(LONG, SLOWLY)
    assert times(override, 0, 4) == [0.0, 1.0]
    override.begin(2)
    override.settle(6, 0.5)
    override.settle(10, sigma)
    assert times(override, 10, 12) == [1.5, 1.5 + 0.5 * sigma]
    assert (override.sigma, override.target, override.dsigma) == (sigma, sigma, 0.0)
    assert override.settled
    assert (override.full, override.resting) == (sigma == 1.0, sigma == 0.0)


@pytest.mark.parametrize("target", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("ticks", [0, 1, 6])
def test_predicted_rest_of_the_path_time_is_reached_by_braking_after_one_more_tick(target, ticks):
    override = Override(LONG, SLOWLY)
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
def test_predicted_path_time_extrapolates_the_speed_rate_up_to_its_limits(sigma, dsigma, h, ends, advance):
    override = Override(LONG, SLOWLY)
    override.place(4, 3.0)
    override.sigma, override.dsigma = sigma, dsigma
    assert override.ahead(4, h) == (3.0 + advance, ends, dsigma)
