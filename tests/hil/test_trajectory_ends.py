"""The first and the last instant of a path and of each of its pieces, and the bits of what repeats."""

import numpy as np
import pytest

from hil.config.reference import Sinusoid, SinusoidReference
from hil.config.values import Pose
from hil.trajectory.build import build_trajectory
from hil.trajectory.piecewise import PiecewisePolynomial
from hil.trajectory.stopping import StoppingTrajectory, path_time
from tests.hil.test_trajectory import move

HOME = Pose(position_m=(0.1, -0.2, 1.0))
KNOTS = np.array([0.0, 0.5, 2.0, 3.0])
PIECES = np.random.default_rng(3).uniform(-1.0, 1.0, (3, 6, 6))
PIECES[:, :, 3:] = 0.0
"""No turn, and nothing joins: each piece is known by its value."""


def polynomial(piece, u):
    """Value, rate and curvature (3, 3) of x, y, z on a piece at u in [0, 1]."""
    h = np.diff(KNOTS)[piece]
    found = []
    for word in range(3):
        p = np.polynomial.Polynomial(PIECES[piece, :, word])
        found.append([p(u), p.deriv()(u) / h, p.deriv(2)(u) / h**2])
    return np.array(found).T


def seen(sample):
    return np.array([sample.p, sample.twist[:3], sample.dtwist[:3]])


@pytest.mark.parametrize("periods", [1, 2, 3, None])
@pytest.mark.parametrize(
    ("t", "piece", "u"),
    [(0.0, 0, 0.0), (0.25, 0, 0.5), (0.5, 1, 0.0), (0.875, 1, 0.25), (2.0, 2, 0.0), (2.5, 2, 0.5)],
)
def test_a_piece_counts_from_its_knot_on_to_before_the_next_one_in_every_period(periods, t, piece, u):
    path = PiecewisePolynomial(KNOTS, PIECES, periods)
    for period in range(periods or 4):
        np.testing.assert_allclose(seen(path.sample(3.0 * period + t)), polynomial(piece, u), atol=1e-12)


@pytest.mark.parametrize("periods", [1, 2, 3])
def test_the_last_piece_counts_to_the_end_of_the_last_period_and_after_it_nothing_moves(periods):
    path = PiecewisePolynomial(KNOTS, PIECES, periods)
    assert path.duration_s == 3.0 * periods
    assert path.period_s == 3.0
    np.testing.assert_array_equal(path.knots, KNOTS)
    end = polynomial(2, 1.0)
    np.testing.assert_allclose(seen(path.sample(3.0 * periods)), end, atol=1e-12)
    for late in (np.nextafter(3.0 * periods, 99.0), 3.0 * periods + 0.25, 3.0 * periods + 7.0):
        sample = path.sample(late)
        np.testing.assert_allclose(sample.p, end[0], atol=1e-12)
        assert not sample.twist.any()
        assert not sample.dtwist.any()


@pytest.mark.parametrize("periods", [1, None])
def test_before_its_beginning_a_path_is_where_it_begins_and_does_not_move(periods):
    path = PiecewisePolynomial(KNOTS, PIECES, periods)
    for early in (-5e-324, -0.25, -2.75):
        sample = path.sample(early)
        np.testing.assert_array_equal(sample.p, PIECES[0, 0, :3])
        assert not sample.twist.any()
        assert not sample.dtwist.any()


def test_a_path_of_one_piece_is_that_piece():
    path = PiecewisePolynomial(np.array([0.0, 0.5]), PIECES[:1])
    for t, u in ((0.0, 0.0), (0.125, 0.25), (0.5, 1.0)):
        np.testing.assert_allclose(seen(path.sample(t)), polynomial(0, u), atol=1e-12)


def test_a_path_keeps_copies_of_its_knots_and_pieces():
    knots, pieces = KNOTS.copy(), PIECES.copy()
    path = PiecewisePolynomial(knots, pieces)
    knots += 1.0
    pieces += 1.0
    path.knots[:] = 9.0
    np.testing.assert_array_equal(path.knots, KNOTS)
    np.testing.assert_allclose(seen(path.sample(0.25)), polynomial(0, 0.5), atol=1e-12)


def wave(ramp_s=0.0, duration_s=4.25):
    """x = 0.1 sin(2 pi 0.5 t + 0.3)."""
    part = Sinusoid(axis="x_m", amplitude=0.1, frequency_Hz=0.5, phase_rad=0.3)
    settings = SinusoidReference(type="sinusoids", components=[part], ramp_s=ramp_s, duration_s=duration_s)
    return build_trajectory(settings, HOME, None)


@pytest.mark.parametrize("t", [0.0, 1.0, 4.25])
def test_without_a_ramp_the_first_and_the_last_instant_are_at_speed(t):
    w = 2 * np.pi * 0.5
    x = 0.1 * np.sin(w * t + 0.3)
    expected = [0.1 + x, 0.1 * w * np.cos(w * t + 0.3), -w * w * x]
    np.testing.assert_allclose(seen(wave().sample(t))[:, 0], expected, atol=1e-12)


@pytest.mark.parametrize(
    ("t", "end"), [(-5e-324, 0.0), (-1.0, 0.0), (np.nextafter(4.25, 9), 4.25), (9.0, 4.25)]
)
def test_outside_its_time_a_wave_rests_where_it_begins_or_ends(t, end):
    sample = wave().sample(t)
    np.testing.assert_array_equal(sample.p, wave().sample(end).p)
    assert not sample.twist.any()
    assert not sample.dtwist.any()


def test_whole_turns_of_a_wave_repeat_to_the_bit_however_many_have_gone_by():
    path = wave(duration_s=80_001.0)
    for t in (0.0, 0.5, 1.25):
        for later in (2.0, 2000.0, 79_998.0):
            for a, b in zip(path.sample(t), path.sample(t + later), strict=True):
                np.testing.assert_array_equal(a, b)


def test_a_ramp_begins_and_ends_with_half_of_the_wave_in_its_middle():
    eased, hard = wave(1.5), wave()
    for t in (0.75, 3.5):
        np.testing.assert_allclose(eased.sample(t).p[0] - 0.1, 0.5 * (hard.sample(t).p[0] - 0.1), atol=1e-15)
    for t in (1.5, 2.0, 2.75):
        for a, b in zip(eased.sample(t), hard.sample(t), strict=True):
            np.testing.assert_allclose(a, b, atol=1e-14)


def test_a_move_rests_to_the_bit_at_and_beyond_its_ends():
    m = move()
    for t, end in ((0.0, 0.0), (-5e-324, 0.0), (-3.0, 0.0), (1.7, 1.7), (1.8, 1.7), (60.0, 1.7)):
        sample = m.sample(t)
        assert sample.p.tobytes() == m.sample(end).p.tobytes()
        assert sample.R.tobytes() == m.sample(end).R.tobytes()
        assert not sample.twist.any()
        assert not sample.dtwist.any()


def test_the_travel_of_a_move_is_its_way_and_its_turn_at_the_reach():
    turn = np.linalg.norm(move()._phi)
    assert turn > 1.0
    assert move().travel_m(0.0) == pytest.approx(np.linalg.norm([0.2, -0.2, 0.1]))
    assert move().travel_m(0.7) == pytest.approx(0.3 + 0.7 * turn)


@pytest.mark.parametrize(
    ("t", "expected"),
    [
        (1.0, (1.0, 1.0, 0.0)),
        (2.0, (2.0, 1.0, 0.0)),
        (
            3.0,
            (2.0 + 4.0 * (0.25 - 0.25**3 + 0.5 * 0.25**4), 1.0 - 3.0 / 16 + 2.0 / 64, 6.0 * 0.25 * -0.75 / 4),
        ),
        (4.0, (2.0 + 4.0 * (0.5 - 0.125 + 1.0 / 32), 0.5, -1.5 / 4.0)),
        (6.0, (4.0, 0.0, 0.0)),
        (7.0, (4.0, 0.0, 0.0)),
    ],
)
def test_the_time_along_a_stop_is_the_clocks_and_then_slows_to_rest_after_half_of_its_duration(t, expected):
    np.testing.assert_allclose(path_time(t, 2.0, 4.0), expected, rtol=0, atol=1e-15)


def test_a_stop_lasts_from_its_beginning_for_its_duration():
    stop = StoppingTrajectory(wave(), 0.5, 0.25)
    assert stop.duration_s == 0.75
    np.testing.assert_array_equal(stop.sample(0.75).p, wave().sample(0.625).p)
