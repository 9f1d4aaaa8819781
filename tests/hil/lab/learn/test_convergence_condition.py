"""The condition of convergence, the filter chosen by it, and predictions of learned accelerations."""

from __future__ import annotations

import numpy as np
import pytest

from hil.app.configuration.changes import with_changes
from hil.app.configuration.configuration import load, loads
from hil.design.stability.sampled_loop import gains, predicting, sampled_axis
from hil.lab.learn.convergence import (
    CONTRACTION,
    AxisLoop,
    Filter,
    Uncertainty,
    axis_loop,
    choose,
    contraction,
    frequencies,
    stated,
)
from hil.lab.learn.judgement import contradiction
from hil.lab.learn.model import belief_of, learner
from hil.lab.learn.trial import predicted, trial, updated
from hil.mathematics.linear_system import lag
from tests.hil.lab.learn.plants import K_D, K_P, LEAD, Plant, T, nominal, run

(LOOP, *_), F = nominal(np.empty(2500))


def worst(loop: AxisLoop, W: float) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """Largest |1 - P/P_0| of an axis G_0 (1 + delta), |delta| = W, in closed loop."""
    L0, G0 = loop.T / loop.S, loop.P / loop.S
    largest = np.zeros(len(L0))
    for angle in np.linspace(0.0, 2.0 * np.pi, 181):
        delta = W * np.exp(1j * angle)
        P = G0 * (1.0 + delta) / (1.0 + L0 * (1.0 + delta))
        largest = np.maximum(largest, np.abs(1.0 - P / loop.P))
    return largest


def test_contraction_bound_holds_for_every_axis_within_the_uncertainty() -> None:
    """|1 - P/P_0| of the closed loops of G_0 (1 + delta), delta all around the circle of the bound."""
    W = 0.3
    c = contraction([LOOP], F, Uncertainty(np.array([0.0, 500.0]), np.array([W, W])))
    largest = worst(LOOP, W)
    assert (largest <= c * (1.0 + 1e-9))[1:].all()
    assert largest[1:] == pytest.approx(c[1:], rel=1e-3)


def test_uncertainty_bound_covers_the_stated_gain_and_delay_errors() -> None:
    bound = stated(0.25, 1e-3, 100.0)
    f = np.linspace(0.1, 99.0, 50)
    off = np.array(
        [
            np.abs((1.0 + g) * np.exp(2j * np.pi * f * d) - 1.0)
            for g in np.linspace(-0.25, 0.25, 11)
            for d in np.linspace(-1e-3, 1e-3, 11)
        ]
    )
    np.testing.assert_allclose(bound.at(f), off.max(axis=0), atol=1e-5)
    assert np.isinf(bound.at(np.array([100.1]))).all(), "the uncertainty must be infinite above 100 Hz"


def test_learning_filter_is_the_widest_that_meets_the_convergence_condition() -> None:
    c = contraction([LOOP], F, stated(0.25, 1e-3, 100.0))
    found = choose(c, F)
    finite = np.where(np.isfinite(c), c, 1e300)
    assert (found.Q.at(F) * finite).max() <= CONTRACTION
    assert (Filter(1.03 * found.Q.end_Hz).at(F) * finite).max() > CONTRACTION
    assert 60.0 < found.Q.end_Hz < 100.0


def test_predicted_effect_of_a_learned_acceleration_agrees_with_a_simulation() -> None:
    """The simulation uses Euler steps of a tenth of a tick; the prediction uses the exact axis."""
    a = np.zeros((LEAD + 1000, 6))
    t = T * np.arange(1000)[:, None]
    a[LEAD:] = (
        np.sin(2.0 * np.pi * 7.0 * t) * np.sin(np.pi * t) ** 2 * np.array([1.0, 2.0, 0.5, -1.0, 0.3, 1.5])
    )
    without, with_a = (run(Plant(), learned, 1.0) for learned in (np.zeros_like(a), a))
    assert without is not None
    assert with_a is not None
    first = trial(T, LEAD, *without, np.zeros_like(a), np.full(6, 20.0))
    loops, _ = nominal(first.e)
    ahead = predicted(first, a, loops)
    change = np.abs(ahead - first.tracked).max()
    assert np.abs(ahead - with_a[0][LEAD:]).max() < 0.03 * change


def test_look_ahead_law_includes_learned_accelerations_in_its_prediction() -> None:
    """Step by step in time: the law predicts with the commands under way, the learned ones included."""
    law = predicting(K_P, K_D, T, bus_s=1e-3, lag_s=0.0, hold_s=0.5e-3)
    axis = sampled_axis(1e-3, lag(0.0), T)
    f = frequencies(4000, T)
    loop = axis_loop(axis, law, f, looks_ahead=True)
    a = np.zeros(4000)
    a[100:1100] = np.sin(2.0 * np.pi * 5.0 * T * np.arange(1000)) * np.sin(np.pi * T * np.arange(1000))
    enters = law.B[:, 0] / law.D[0, 0]
    without = law.A - np.outer(enters, law.C[0])
    x, z, e = np.zeros(axis.order), np.zeros(law.order), np.zeros(4000)
    for k in range(4000):
        y = axis.C @ x
        e[k] = -y[0]
        asked = float(law.C[0] @ z + law.D[0] @ -y) + a[k]
        x, z = axis.A @ x + axis.B[:, 0] * asked, without @ z + enters * asked
    expected = -np.fft.irfft(loop.P * np.fft.rfft(a), 4000)
    assert np.abs(e - expected).max() < 0.01 * np.abs(e).max()


def test_learning_update_with_the_true_axis_removes_the_error_within_the_filter_band() -> None:
    e0, de0 = run(Plant(), np.zeros((LEAD + 1000, 6)), 0.9) or (None, None)
    assert e0 is not None
    assert de0 is not None
    first = trial(T, LEAD, e0, de0, np.zeros_like(e0), np.full(6, 20.0))
    loops, f = nominal(first.e)
    a = updated(first, loops, Filter(80.0), f)
    assert not a[0].any(), "the learned acceleration must begin at zero"
    assert np.abs(predicted(first, a, loops)).max() < 0.01 * first.peak_m
    half = updated(first, loops, Filter(80.0), f, 0.5)
    np.testing.assert_allclose(half, 0.5 * a, atol=1e-12)


def test_growing_error_without_a_learned_change_contradicts_the_stated_uncertainty() -> None:
    """Beyond the stated band the contraction is infinite; its product with a zero change must be zero."""
    zero = np.zeros((LEAD + 1000, 6))
    e = zero.copy()
    e[LEAD:, 2] = 1e-4 * np.sin(2.0 * np.pi * 20.0 * T * np.arange(1000))
    before, now = (trial(T, LEAD, k * e, zero, zero, np.full(6, 20.0)) for k in (1.0, 3.0))
    loops, f = nominal(now.e)
    unknown = np.full(len(f), np.inf)
    said = contradiction(before, now, loops, unknown, Filter(80.0), f, first_rms_m=before.rms_m, noise_m=0.0)
    assert said is not None
    assert said.axis == 2
    assert said.factor == pytest.approx(3.0, rel=1e-6)
    assert said.allowed == pytest.approx(1.5, rel=1e-6), "allowed: the previous error times the margin"


WN = [20.0, 20.0, 25.0, 15.0, 20.0, 30.0]


@pytest.mark.parametrize(
    ("bus_ms", "drive_lag_ms", "hold_ms"),
    [(0.9, 0.8, 0.5), (0.4, 0.7, 0.0)],
)
def test_model_of_a_look_ahead_law_uses_its_own_bus_lag_and_hold(
    bus_ms: float, drive_lag_ms: float, hold_ms: float
) -> None:
    delay = {"bus_ms": bus_ms, "drive_lag_ms": drive_lag_ms, "hold_ms": hold_ms}
    controller = {"wn_rad_s": WN, "delay_compensation": delay}
    c = load("virtual")
    c = loads(with_changes(c.text, {"name": "virtual", "controller": controller}), "virtual", c.folder)
    belief = belief_of(c, None, 0.25, 1e-3)
    found = learner(c, belief, 2500).loops
    f = frequencies(2500, T)
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


def test_contraction_bound_of_unequal_legs_is_that_of_the_worst_leg() -> None:
    """Each axis is off by W at its own worst angle, in its own closed loop: all stay within the bound."""
    W, f = 0.3, frequencies(2500, T)
    unlike = [
        axis_loop(sampled_axis(delay_s, lag(0.8e-3), T), gains(wn**2, 2.0 * wn, T), f, looks_ahead=False)
        for wn, delay_s in zip(WN, (1e-3, 2e-3, 1e-3, 3e-3, 1e-3, 1e-3), strict=True)
    ]
    known = Uncertainty(np.array([0.0, 500.0]), np.array([W, W]))
    largest = np.max([worst(loop, W) for loop in unlike], axis=0)
    for order in (unlike, unlike[::-1], unlike[3:] + unlike[:3]):
        c = contraction(order, f, known)
        assert (largest <= c * (1.0 + 1e-9))[1:].all()
    assert (worst(unlike[5], W) < 0.5 * largest)[1:10].any(), "the legs differ"
