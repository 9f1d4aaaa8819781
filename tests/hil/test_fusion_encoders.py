"""Outlier rejection of the filter: encoders, the tracker, and single components of both."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hil.config.estimation import FusionSettings
from hil.contracts.records import altered
from hil.estimation.fusion import FusedEstimator
from hil.estimation.fusion_tick import LEFT_OUT_TICKS, SLIP_TICKS
from hil.robot.dynamics import Model
from tests import sensor_samples
from tests.hil.fusion_bench import (
    LEGS,
    MS,
    PLATFORM,
    TRACKER,
    ZERO,
    Driven,
    T,
    Truth,
    error,
    estimator,
    legs,
    measurement,
    settled,
    state_of,
    update,
)
from tests.sensor_samples import Readings, Sample


@pytest.mark.parametrize("leg", range(6))
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_encoder_slip_of_2_mm_is_rejected_and_reported_at_once(leg, sign):
    found, truth = settled()
    q, dq = legs(truth.p, truth.R, ZERO)
    q[leg] += sign * 2e-3
    for tick in range(100, 130):
        fused = update(found, tick, measurement(q, dq))
        assert fused.used == tuple(i != leg for i in range(6))
        assert fused.health.slipped == tuple(i == leg and tick >= 99 + SLIP_TICKS for i in range(6))
        assert fused["innovation_q"][leg] == pytest.approx(sign * 2e-3, abs=1e-5)
    assert np.abs(fused["p"] - truth.p).max() < 1e-5


@pytest.mark.parametrize(
    ("axis", "speed"), [(2, 1.0), *((axis, sign * 0.02) for axis in range(6) for sign in (1, -1))]
)
def test_motion_of_all_legs_is_followed_and_not_taken_for_a_slip(axis, speed):
    found, truth = settled()
    truth.twist = speed * (np.arange(6) == axis)
    for tick in range(100, 130):
        truth.p = truth.p + T * truth.twist[:3]
        truth.R = Rotation.from_rotvec(T * truth.twist[3:]) * truth.R
        fused = update(found, tick, measurement(*legs(truth.p, truth.R, truth.twist)))
        assert not any(fused.health.slipped)
        assert all(fused.used)
        assert np.abs(error(fused, truth)[:6]).max() < 2e-5


def test_single_outliers_are_never_reported_as_a_slip():
    found, truth = settled()
    q, dq = legs(truth.p, truth.R, ZERO)
    off = q + 2e-3 * (np.arange(6) == 3)
    used = []
    for tick in range(100, 100 + 4 * SLIP_TICKS):
        outlier = tick % SLIP_TICKS != 0
        used.append(update(found, tick, measurement(off if outlier else q, dq)).used[3])
    assert not found.record["slipped"].any()
    assert used == [tick % SLIP_TICKS == 0 for tick in range(100, 100 + 4 * SLIP_TICKS)]


def test_leg_with_an_encoder_error_too_small_for_a_slip_is_used_again_after_a_while():
    found, truth = settled()
    q, dq = legs(truth.p, truth.R, ZERO)
    q[1] += 0.1e-3
    used = [update(found, tick, measurement(q, dq)).used[1] for tick in range(100, 120)]
    assert not any(used[:LEFT_OUT_TICKS])
    assert used[LEFT_OUT_TICKS]
    assert not found.record["slipped"].any()


def test_silent_leg_and_leg_without_encoder_are_left_out_of_the_filter_and_recover():
    found, truth = settled()
    q, dq = legs(truth.p, truth.R, ZERO)
    for tick in range(100, 110):
        age = np.array([tick - 99, 0, 0, 0, 0, 0])
        ages = age + np.array([0, 0, 0, tick - 99, 0, 0])
        m = altered(measurement(q, dq), age=ages, blind=[0, 0, 0, 1, 0, 0])
        fused = update(found, tick, m)
        assert fused.used == (False, True, True, False, True, True)
        assert fused.health.lost == (tick >= 101, False, False, True, False, False)
    fused = update(found, 110, measurement(q, dq))
    assert all(fused.used)
    assert not any(fused.health.lost)


def test_feedback_age_of_a_leg_that_may_be_lost_counts_as_zero():
    settings = FusionSettings(may_lose_legs=[2])
    truth = Truth(7)
    found = FusedEstimator(PLATFORM, Model(PLATFORM), settings, LEGS, TRACKER, None, T)
    found.start(0, 0, truth.p, truth.R.as_matrix())
    for tick, lost, ages, unseen in (
        (1, (), [0] * 6, 0),
        (2, (2,), [0] * 6, 1),
        (3, (4,), [0, 0, 0, 0, 9, 0], 1),
        (4, (), [0] * 6, 0),
    ):
        record = altered(measurement(*legs(truth.p, truth.R, ZERO), lost=lost), tick=tick)
        sensor_samples.update(found, record, tick * MS, Readings(), ZERO, ZERO)
        assert record["counted_age"].tolist() == ages
        assert record["unseen"] == unseen


def test_tracker_bounds_the_uncertainty_with_a_lost_leg():
    found, truth = settled()
    q, dq = legs(truth.p, truth.R, ZERO)
    for tick in range(100, 3000):
        samples = [truth.track(tick - 1, 0.0)] if tick % 5 == 0 and tick < 2000 else []
        fused = update(found, tick, measurement(q, dq, lost=(0,)), samples)
        if tick == 1999:
            with_it = fused.health.position_std
    assert with_it < 0.4e-3
    assert fused.health.position_std > 10 * with_it, "the uncertainty must grow in a second without tracker"


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("word", range(6))
def test_tracker_sample_with_one_outlier_component_is_rejected(word, sign):
    found, truth = settled()
    off = sign * 0.05 * (np.arange(6) == word)
    R = Rotation.from_rotvec(off[3:]) * truth.R
    m = measurement(*legs(truth.p, truth.R, ZERO))
    fused = update(found, 100, m, [Sample(99, 0.0, (*(truth.p + off[:3]), *R.as_rotvec()))])
    assert fused["tracker"] == -1
    np.testing.assert_allclose(fused["innovation_tracker"], off, atol=1e-5)
    assert np.abs(error(fused, truth)).max() < 1e-5
    right = Sample(100, 0.0, (*truth.p, *truth.R.as_rotvec()))
    assert update(found, 101, m, [right])["tracker"] == 1


def test_columns_of_the_fused_estimate_are_consistent():
    """One leg is an outlier and rejected."""
    found, truth = settled()
    q, dq = legs(truth.p, truth.R, ZERO)
    q[3] += 2e-3
    fused = update(found, 100, measurement(q, dq))
    x, P = state_of(found)
    assert fused["p"].tolist() == x[:3].tolist()
    assert fused["R"].ravel().tolist() == x[3:12].tolist()
    assert fused["twist"].tolist() == x[12:18].tolist()
    length, rate = legs(x[:3], Rotation.from_matrix(fused["R"]), x[12:18])
    assert fused["q"] == pytest.approx(length, abs=1e-14)
    assert fused["dq"] == pytest.approx(rate, abs=1e-14)
    assert fused["J"] @ fused["twist"] == pytest.approx(rate, abs=1e-14)
    assert fused["pose_std"] == pytest.approx(np.sqrt(P.diagonal()[:6]))
    assert fused["fk_residual"] == pytest.approx(np.abs(np.delete(q - length, 3)).max(), abs=1e-14)
    assert 1.0 < fused["condition"] < 50.0


@pytest.fixture(scope="module")
def pushed():
    """A platform pushed upward from rest by its drives: its final state, and the measurements."""
    truth = Driven(ZERO)
    tau = truth.hold + 2000.0
    ticks = []
    for _ in range(39 + LEFT_OUT_TICKS):
        truth.step(tau)
        ticks.append(truth.measure(tau))
    return truth, ticks


@pytest.mark.parametrize("leg", range(6))
@pytest.mark.parametrize("share", [0.0, -1.0], ids=["dead", "of the wrong sign"])
def test_leg_with_a_wrong_rate_is_rejected_by_the_filter(pushed, leg, share):
    found = estimator(FusionSettings(), LEGS)
    scale = np.where(np.arange(6) == leg, share, 1.0)
    truth, ticks = pushed
    for tick, measured in enumerate(ticks, 1):
        wrong = tick >= 40
        fused = update(found, tick, altered(measured, rate=measured["rate"] * (scale if wrong else 1.0)))
        assert fused.used == (tuple(i != leg for i in range(6)) if wrong else (True,) * 6)
    assert np.abs(error(fused, truth)).max() < 1e-4
