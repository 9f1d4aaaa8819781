"""Sensor samples in a tick, and the pose from which the legs continue alone."""

from __future__ import annotations

import ctypes
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from drivers.compiled.compiler import INTEGER
from drivers.compiled.pointed import of_python
from drivers.frame_array import NO_FRAMES, received_array
from drivers.protocol import Received
from drivers.sensing.layout import NEVER
from drivers.sensing.settings import TrackerSettings, WrenchSensorSettings
from drivers.sensors import SensorProtocol
from drivers.tick_columns import tick_at
from hil.app.compose import build_cycle
from hil.config.estimation import FusionSettings
from hil.contracts.records import record_of
from hil.estimation.external_wrench import ExternalWrench
from hil.estimation.fusion import FusedEstimator
from hil.estimation.fusion_layout import LegErrors
from hil.loop.compiled_pass import AGREED_m, observe
from hil.loop.cycle import Cycle
from hil.loop.sight import Sight
from hil.robot.dynamics import Model
from tests.hil.cycle_bench import VIRTUAL
from tests.sensor_samples import encode

ALL = 0b111111
KEPT: list[Any] = []
"""Callbacks made by a test."""
TURNED = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


@pytest.fixture(scope="module")
def parts() -> Any:
    return build_cycle(VIRTUAL, 1000.0, 0.01).parts


def observe_in(cycle: Cycle, tick: Any, frames: Any = NO_FRAMES, last: Any = None) -> None:
    """Run the compiled pass of a cycle with a known pose on a tick."""
    cycle.sight.located = True
    cycle.sight.fusing = cycle.parts.fusion is not None
    cycle.control.settle()
    observe(cycle.control.record, tick, record_of() if last is None else last, frames)


def see(sight: Sight, tick: Any) -> None:
    """Fill the estimate of a tick, before the pose is known or from the legs alone."""
    tick["q"], tick["dq"] = tick["length"], tick["rate"]
    if sight.located:
        sight.update(tick)
    else:
        sight.locate(tick)


SENSORS = VIRTUAL.sensors.model_copy(update={"wrench": WrenchSensorSettings(rate_Hz=500.0)})
P = SensorProtocol(VIRTUAL.bus, SENSORS)
LOAD = (100.0, -200.0, 300.0, 10.0, -20.0, 30.0)


def load_frames(*samples: tuple[float, float]) -> Any:
    """Frames of the wrench sensor: share of LOAD, and its sample time after the SYNC of tick 4."""
    return received_array(
        [
            Received(0, encode(P, "wrench", [share * x for x in LOAD], 4, offset_s, k))
            for k, (share, offset_s) in enumerate(samples)
        ]
    )


def test_rejected_sensor_frames_are_counted_in_total_and_separately(parts):
    good = load_frames((1.0, 0.0))
    bad = good.copy()
    bad["data"][:, 0] ^= 1
    tick = record_of(tick=5)
    observe_in(Cycle(replace(parts, sensors=P)), tick, np.concatenate((bad, good, bad)))
    assert (int(tick["rejected"]), int(tick["sensors_rejected"])) == (2, 2)


@pytest.mark.parametrize("fusing", [True, False])
def test_newest_wrench_sample_is_rotated_to_the_base_frame_by_the_last_pose(parts, fusing):
    wrench = ExternalWrench(None, 500.0, 1e-3)
    cycle = Cycle(replace(parts, wrench=wrench, sensors=P, fusion=fused(parts) if fusing else None))
    seen = cycle.parts.fusion if fusing else cycle.sight.estimator
    assert seen is not None
    seen.record["R"] = TURNED
    observe_in(cycle, record_of(tick=5, age=0), load_frames((0.0, 1e-4), (1.0, 3e-4), (0.5, 2e-4)))
    x, y, z, mx, my, mz = LOAD
    np.testing.assert_allclose(wrench._record["reading"], [-y, x, z, -my, mx, mz], atol=1e-9)


def fused(parts: Any) -> FusedEstimator:
    tracker = TrackerSettings()
    return FusedEstimator(
        parts.platform, Model(parts.platform), FusionSettings(), LegErrors(1e-5, 1e-3), tracker, None, 1e-3
    )


def seen_by_filter(parts: Any, **different: Any) -> tuple[Cycle, list[Any]]:
    """Cycle with a filter of given legs used and residual at R, p; and the list of its calls."""
    called: list[Any] = []

    def fuse(_filter: int, _sensors: int, command: int, wrench: int, at: int) -> int:
        tick = tick_at(at)
        numbers = (
            np.ctypeslib.as_array((ctypes.c_double * 6).from_address(a)).tolist() for a in (command, wrench)
        )
        called.append(tuple(numbers))
        tick["p"], tick["R"] = [0.1, 0.2, 0.9], TURNED
        tick["legs_used"], tick["fk_residual"] = different.get("legs", ALL), different.get("residual", 1.0)
        return 0

    wrench = different.get("wrench", parts.wrench)
    cycle = Cycle(replace(parts, wrench=wrench, fusion=fused(parts), sensors=P))
    cycle.control.record["fuse"], keeps = of_python(fuse, *[INTEGER] * 5)
    KEPT.append(keeps)
    return cycle, called


@pytest.mark.parametrize(
    ("legs", "residual", "agreed"),
    [(ALL, 0.999 * AGREED_m, True), (ALL, AGREED_m, False), (0b111101, 0.0, False)],
)
def test_kinematic_estimator_takes_from_the_filter_only_a_pose_of_all_six_legs(parts, legs, residual, agreed):
    cycle, called = seen_by_filter(parts, legs=legs, residual=residual)
    tick = record_of(tick=5, age=0, length=1.5)
    observe_in(cycle, tick, last=record_of(tau=[1.0, 2.0, 3.0, 4.0, 5.0, 6.0]))
    assert called[0][0] == [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]
    estimator = cycle.sight.estimator
    np.testing.assert_array_equal(estimator.p, [0.1, 0.2, 0.9] if agreed else parts.home_p)
    np.testing.assert_array_equal(estimator.R, TURNED if agreed else parts.home_R)
    np.testing.assert_array_equal(tick["p"], [0.1, 0.2, 0.9])


def test_a_repeated_sensor_sample_counts_only_after_a_reset(parts):
    cycle = Cycle(replace(parts, sensors=P))
    for heard in (1, 0):
        observe_in(cycle, record_of(tick=5), load_frames((1.0, 0.0)))
        assert cycle.sight.sensors.slots["count"][:3].tolist() == [0, 0, heard], "a repeated sample"
    cycle.sight.reset()
    observe_in(cycle, record_of(tick=5), load_frames((1.0, 0.0)))
    assert cycle.sight.sensors.slots["count"][:3].tolist() == [0, 0, 1]


# -- the first pose


class Looking:
    """Estimator that finds the pose on demand. State: the first length of each search."""

    def __init__(self, sight: Sight) -> None:
        self.p, self.R, self.finds = sight.estimator.p, sight.estimator.R, False
        self.asked: list[float] = []

    def acquire(self, q: Any) -> bool:
        self.asked.append(float(q[0]))
        return self.finds

    def update(self, tick: Any) -> None:
        tick["p"] = 7.0

    def adopt(self, p: Any, R: Any) -> None:
        self.p, self.R = p, R


def looking(parts: Any, rate_Hz: float = 1000.0) -> tuple[Sight, Looking]:
    sight = Sight(replace(parts, rate_Hz=rate_Hz))
    sight.estimator = looks = Looking(sight)  # type: ignore[assignment]
    return sight, looks


@pytest.mark.parametrize(("rate_Hz", "every"), [(1000.0, 20), (400.0, 8), (100.0, 6)])
def test_pose_search_at_the_start_runs_every_20_ms_but_at_most_every_sixth_tick(parts, rate_Hz, every):
    sight, looks = looking(parts, rate_Hz)
    for number in range(1, 4 * every + 1):
        see(sight, record_of(tick=number, age=0, length=float(number)))
    assert looks.asked == [every, 2 * every, 3 * every, 4 * every]


@pytest.mark.parametrize("leg", [0, 5])
def test_pose_search_that_is_due_waits_for_feedback_of_all_six_legs(parts, leg):
    sight, looks = looking(parts)
    late = 1 * (np.arange(6) == leg)
    for number in range(15, 31):
        tick = record_of(tick=number, age=0 if number == 27 else late, length=float(number))
        see(sight, tick)
        assert sight.sought is (number >= 27)
        np.testing.assert_array_equal(tick["p"], looks.p)
        np.testing.assert_array_equal(tick["R"], looks.R)
        assert tick["fk_residual"] == tick["condition"] == np.inf
        assert (tick["q"][0], sight.located) == (number, False)
    assert looks.asked == [27]


def test_a_found_pose_is_tracked_and_never_searched_again(parts):
    sight, looks = looking(parts)
    for number in range(40, 100):
        looks.finds = number >= 60
        tick = record_of(tick=number, age=0)
        see(sight, tick)
        assert sight.located is (number >= 60)
        assert (float(tick["p"][0]) == 7.0) is (number >= 60)
    assert len(looks.asked) == 2


def test_a_silent_leg_is_extrapolated_at_its_last_rate(parts):
    sight, _ = looking(parts)
    sight.located = True
    rates, ages = 0.1 * (1.0 + np.arange(6)), np.array([0, 1, 2, 3, 0, 9])
    tick = record_of(tick=9, length=1.5, rate=rates, age=ages)
    see(sight, tick)
    np.testing.assert_allclose(tick["q"], 1.5 + 1e-3 * rates * ages, rtol=0.0, atol=1e-15)
    np.testing.assert_array_equal(tick["dq"], rates)
    np.testing.assert_array_equal(tick["length"], np.full(6, 1.5))


def test_pose_search_starts_at_the_last_pose_and_after_a_reset_at_home(parts):
    sight = Sight(parts)
    p = parts.home_p + 0.1
    for back, stays in ((sight.forget, True), (sight.reset, False)):
        sight.estimator.adopt(p, TURNED)
        sight.located = sight.sought = sight.due = sight.fusing = True
        sight.sensors.slots["counter"] = 3
        back()
        assert [sight.located, sight.sought, sight.due, sight.fusing] == [False] * 4
        assert set(sight.sensors.slots["counter"].tolist()) == {3 if stays else NEVER}
        np.testing.assert_array_equal(sight.estimator.p, p if stays else parts.home_p)
        np.testing.assert_array_equal(sight.estimator.R, TURNED if stays else parts.home_R)
