"""Commanded forces on their way to the legs, against the differential equation integrated by scipy."""

from math import exp

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.signal import lfilter

from hil.robot.force_path import ForcePath, decay

T = 1e-3
COMMANDS = np.random.default_rng(3).normal(0.0, 1e4, (12, 6))


def exact_mean(transport, lag, k):
    """Mean force from k T to (k + 1) T, command n acting from n T + transport on, on a grid of 1 us."""
    fine = 1000
    steps = fine * (k + 1)
    t = (np.arange(steps) + 0.5) * T / fine
    index = np.floor((t - transport) / T + 1e-9).astype(int)
    u = np.where(index[:, None] < 0, 0.0, COMMANDS[np.clip(index, 0, None)])
    if lag > 0.0:
        a = exp(-T / fine / lag)
        u = lfilter([1.0 - a], [1.0, -a], u, axis=0)
    return u[-fine:].mean(axis=0)


@pytest.mark.parametrize("lag", [0.0, 0.8e-3, 3e-3])
@pytest.mark.parametrize("transport", [0.0, 0.5e-3, 1e-3, 1.7e-3, 2.25e-3])
def test_mean_force_between_two_measurements(transport, lag):
    path = ForcePath(T, transport, lag)
    path.advance()
    for k, command in enumerate(COMMANDS):
        path.send(command)
        mean = path.advance()
        np.testing.assert_allclose(mean, exact_mean(transport, lag, k), atol=20.0 if lag else 1e-8)


def test_lag_is_exact_over_a_hold():
    """A step of 100 N after 0.4 ms through a lag of 0.5 ms: mean over the first ms by quadrature."""
    path = ForcePath(T, 0.4e-3, 0.5e-3)
    path.send(np.full(6, 100.0))
    expected = quad(lambda t: 100.0 * (1.0 - exp(-(t - 0.4e-3) / 0.5e-3)), 0.4e-3, T)[0] / T
    np.testing.assert_allclose(path.advance(), expected, rtol=1e-12)
    np.testing.assert_allclose(path.force, 100.0 * (1.0 - exp(-0.6 / 0.5)), rtol=1e-12)


def test_skipped_periods_hold_the_last_command():
    skipping, sending = ForcePath(T, 0.4e-3, 0.5e-3), ForcePath(T, 0.4e-3, 0.5e-3)
    means = []
    for path in (skipping, sending):
        path.send(COMMANDS[0])
        path.advance()
        path.send(COMMANDS[1])
    for _ in range(3):
        means.append(sending.advance())
        sending.send(COMMANDS[1])
    np.testing.assert_allclose(skipping.advance(3), np.mean(means, axis=0), rtol=1e-12)
    np.testing.assert_allclose(skipping.force, sending.force, rtol=1e-12)


def test_the_horizon_is_cut_by_the_commands_that_act():
    path = ForcePath(T, 1.6e-3, 0.0)
    cut = path.segments(2.1e-3)
    assert [s.sent for s in cut] == [1, 0], "the command to come is taken to be as the last one"
    assert [s.duration_s for s in cut] == pytest.approx([0.6e-3, 1.5e-3])
    assert sum(s.duration_s for s in path.segments(0.2e-3)) == pytest.approx(0.2e-3)
    assert path.segments(0.0) == ()


def test_reset_forgets_all_forces():
    path = ForcePath(T, 1.2e-3, 0.5e-3)
    for command in COMMANDS:
        path.send(command)
        path.advance()
    path.reset()
    assert not path.advance().any()


def test_decay_is_the_exponential():
    for x in (0.0, 1e-9, 0.05, 0.3, 1.0, 7.0, 40.0):
        assert decay(x) == pytest.approx(exp(-x), rel=1e-13)
    assert decay(1e30) == 0.0, "of a lag that vanishes"
