"""What learning reckons with where the legs, or the parts of a delay, are not alike."""

from __future__ import annotations

import numpy as np
import pytest

from hil.app.configuration.changes import with_changes
from hil.app.configuration.configuration import load, loads
from hil.design.stability.prediction import predicting
from hil.design.stability.sampled import gains
from hil.design.stability.sampled_loop import sampled_axis
from hil.lab.learn.convergence import Uncertainty, contraction, stated
from hil.lab.learn.loop import axis_loop, frequencies
from hil.lab.learn.model import Belief, belief_of, learner
from hil.mathematics.linear_system import lag
from tests.hil.lab.learn.test_condition import worst

T, SAMPLES = 1e-3, 2500
WN = [20.0, 20.0, 25.0, 15.0, 20.0, 30.0]


@pytest.mark.parametrize(
    ("bus_ms", "drive_lag_ms", "hold_ms"),
    [(0.9, 0.8, 0.5), (0.0, 1.5, 0.5), (1.2, 0.0, 0.5), (0.4, 0.7, 0.0)],
)
def test_a_law_that_looks_ahead_is_reckoned_with_its_own_bus_lag_and_hold(
    bus_ms: float, drive_lag_ms: float, hold_ms: float
) -> None:
    delay = {"bus_ms": bus_ms, "drive_lag_ms": drive_lag_ms, "hold_ms": hold_ms}
    controller = {"wn_rad_s": WN, "delay_compensation": delay}
    c = load("virtual")
    c = loads(with_changes(c.text, {"name": "virtual", "controller": controller}), "virtual", c.folder)
    belief = belief_of(c, None, 0.25, 1e-3)
    found = learner(c, belief, SAMPLES).loops
    f = frequencies(SAMPLES, T)
    axis = sampled_axis(belief.transport_s, lag(belief.lag_s), T)
    for loop, wn in zip(found, WN, strict=True):
        law = predicting(
            wn**2,
            2.0 * wn,
            T,
            bus_s=1e-3 * bus_ms,
            lag_s=1e-3 * drive_lag_ms,
            hold_s=1e-3 * hold_ms,
        )
        np.testing.assert_allclose(loop.P, axis_loop(axis, law, f, looks_ahead=True).P, rtol=1e-9)


def test_of_unlike_legs_the_worst_bounds_the_contraction_whichever_leg_it_is() -> None:
    """An axis that is off by W at its own worst angle, each axis closed anew: all stay within the bound."""
    W, f = 0.3, frequencies(SAMPLES, T)
    unlike = [
        axis_loop(sampled_axis(delay_s, lag(0.8e-3), T), gains(wn**2, 2.0 * wn, T), f, looks_ahead=False)
        for wn, delay_s in zip(WN, (1e-3, 2e-3, 1e-3, 3e-3, 1e-3, 1e-3), strict=True)
    ]
    known = Uncertainty(np.array([0.0, 500.0]), np.array([W, W]))
    largest = np.max([worst(loop, W) for loop in unlike], axis=0)
    for order in (unlike, unlike[::-1], unlike[3:] + unlike[:3]):
        c = contraction(order, f, known)
        assert (largest <= c * (1.0 + 1e-9))[1:].all()
    assert (worst(unlike[5], W) < 0.5 * largest)[1:10].any(), "they are unlike"


@pytest.mark.parametrize("first", range(6))
def test_each_leg_is_reckoned_with_the_gain_that_was_identified_of_it(first: int) -> None:
    gains_of_legs = np.roll([0.8, 1.0, 1.2, 1.0, 0.9, 1.1], first)
    c = load("virtual")
    belief = Belief(gains_of_legs, 1e-3, 0.8e-3, stated(0.25, 1e-3, 100.0), "a test")
    found = learner(c, belief, SAMPLES).loops
    f, wn = frequencies(SAMPLES, T), 20.0
    for loop, gain in zip(found, gains_of_legs.tolist(), strict=True):
        axis = sampled_axis(1e-3, lag(0.8e-3), T, gain)
        expected = axis_loop(axis, gains(wn**2, 2.0 * wn, T), f, looks_ahead=False)
        np.testing.assert_allclose(loop.P, expected.P, rtol=1e-9)


@pytest.mark.parametrize("rate_Hz", [100.0, 400.0, 1000.0, 2000.0])
def test_what_is_stated_of_an_axis_holds_up_to_a_tenth_of_the_rate_whatever_that_is(rate_Hz: float) -> None:
    c = load("virtual")
    c = c.model_copy(update={"loop": c.loop.model_copy(update={"rate_Hz": rate_Hz})})
    bound = belief_of(c, None, 0.25, 1e-3).uncertainty
    at = bound.at(np.array([0.01, 0.099, 0.101, 0.4]) * rate_Hz)
    np.testing.assert_array_equal(np.isfinite(at), [True, True, False, False])
