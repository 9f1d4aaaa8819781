"""What the filter leaves out and what it believes: legs, tracker and brakes, whichever way they are off."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drivers.config import ImuSettings
from hil.config.estimation import FusionSettings
from hil.contracts.records import altered
from hil.estimation.fusion import FusedEstimator
from hil.estimation.fusion_tick import LEFT_OUT_TICKS, SLIP_TICKS
from hil.robot.dynamics import Model
from tests.hil.test_fusion import (
    LEGS,
    LOOSE,
    LOOSE_LEGS,
    PLATFORM,
    TRACKER,
    ZERO,
    Driven,
    Fused,
    T,
    Truth,
    error,
    estimator,
    legs,
    measurement,
    settled,
    update,
)
from tests.sensed import Readings, Sample

ON_EACH_LEG = pytest.mark.parametrize("leg", range(6))
EITHER_WAY = pytest.mark.parametrize("sign", [1.0, -1.0])


def all_but(leg):
    return tuple(i != leg for i in range(6))


@ON_EACH_LEG
@EITHER_WAY
def test_an_encoder_that_slips_is_named_whether_it_reads_too_long_or_too_short(leg, sign):
    found, truth = settled()
    q, dq = legs(truth.p, truth.R, ZERO)
    q[leg] += sign * 2e-3
    for tick in range(100, 100 + LEFT_OUT_TICKS + 2):
        fused = update(found, tick, measurement(q, dq))
        assert fused.used == all_but(leg)
    assert fused.health.slipped == tuple(i == leg for i in range(6))


@EITHER_WAY
def test_single_outliers_are_no_slip_however_many_there_are(sign):
    found, truth = settled()
    q, dq = legs(truth.p, truth.R, ZERO)
    off = q + sign * 2e-3 * (np.arange(6) == 3)
    used = []
    for tick in range(100, 100 + 4 * SLIP_TICKS):
        outlier = tick % SLIP_TICKS != 0
        used.append(update(found, tick, measurement(off if outlier else q, dq)).used[3])
    assert not found.record["slipped"].any()
    assert used == [tick % SLIP_TICKS == 0 for tick in range(100, 100 + 4 * SLIP_TICKS)]


@pytest.fixture(scope="module")
def pushed():
    """A platform that its drives push upward from rest: where it is in the end, and what is measured."""
    truth = Driven(ZERO)
    tau = truth.hold + 2000.0
    ticks = []
    for _ in range(39 + LEFT_OUT_TICKS):
        truth.step(tau)
        ticks.append(truth.measure(tau))
    return truth, ticks


@ON_EACH_LEG
@pytest.mark.parametrize("share", [0.0, -1.0], ids=["dead", "of the wrong sign"])
def test_a_leg_whose_rate_alone_is_wrong_is_left_out(pushed, leg, share):
    found = estimator(FusionSettings(), LEGS)
    scale = np.where(np.arange(6) == leg, share, 1.0)
    truth, ticks = pushed
    for tick, measured in enumerate(ticks, 1):
        wrong = tick >= 40
        fused = update(found, tick, altered(measured, rate=measured["rate"] * (scale if wrong else 1.0)))
        assert fused.used == (all_but(leg) if wrong else (True,) * 6)
    assert np.abs(error(fused, truth)).max() < 1e-4


@EITHER_WAY
@pytest.mark.parametrize("word", range(6))
def test_a_tracker_sample_of_which_one_word_is_far_off_is_refused(word, sign):
    found, truth = settled()
    off = sign * 0.05 * (np.arange(6) == word)
    R = Rotation.from_rotvec(off[3:]) * truth.R
    wrong = Sample(99, 0.0, (*(truth.p + off[:3]), *R.as_rotvec()))
    fused = update(found, 100, measurement(*legs(truth.p, truth.R, ZERO)), [wrong])
    assert fused["tracker"] == -1
    np.testing.assert_allclose(fused["innovation_tracker"], off, atol=1e-5)
    assert np.abs(error(fused, truth)).max() < 1e-5


@EITHER_WAY
@pytest.mark.parametrize("axis", range(6))
def test_a_platform_that_creeps_on_shut_brakes_is_followed_and_no_leg_is_left_out(axis, sign):
    found, truth = settled()
    twist = sign * 0.02 * (np.arange(6) == axis)
    for tick in range(100, 140):
        truth.p = truth.p + T * twist[:3]
        truth.R = Rotation.from_rotvec(T * twist[3:]) * truth.R
        truth.twist = twist
        fused = update(found, tick, measurement(*legs(truth.p, truth.R, twist)))
        assert all(fused.used)
    assert np.abs(error(fused, truth)).max() < 1e-5


@pytest.mark.parametrize("late", [4, 7])
def test_a_late_sample_counts_beside_newer_ones_that_come_in_the_same_tick(late):
    """An IMU in time in each tick; the tracker's samples in pairs, the first of them `late` ticks old."""
    truth = Truth(3)
    imu = ImuSettings(rate_Hz=1000.0)
    prompt, tardy = (
        FusedEstimator(PLATFORM, Model(PLATFORM), LOOSE, LOOSE_LEGS, TRACKER, imu, T) for _ in range(2)
    )
    for each in (prompt, tardy):
        each.start(0, 0, truth.p, truth.R.as_matrix())
    waiting: list[Sample] = []
    pairs = 0
    for tick in range(1, 61):
        samples = [truth.track(tick - 1, 0.0004)] if tick % (late + 3) in {1, 1 + late} else []
        waiting += samples
        truth.step()
        due = waiting if tick % (late + 3) == 1 + late or tick == 60 else []
        pairs += len(due) == 2
        w = Sample(tick - 1, 0.0005, (*truth.twist[3:], *-PLATFORM.gravity))
        m = truth.measure()
        a = Fused(prompt, tick, m, Readings(tracker=tuple(samples), imu=(w,)))
        b = Fused(tardy, tick, m, Readings(tracker=tuple(due), imu=(w,)))
        if due:
            waiting = []
    assert pairs > 3
    assert np.array_equal(*(each._steps[each.record["newest"]]["x"] for each in (prompt, tardy)))
    assert np.array_equal(
        prompt._covariances[prompt.record["newest"]], tardy._covariances[tardy.record["newest"]]
    )
    assert np.array_equal(a["p"], b["p"])
