"""What is heard of sensors in a tick, and from which pose the legs go on alone."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from drivers.sensors import Readings, Sample
from hil.app.compose import build_cycle
from hil.app.configuration.configuration import load
from hil.estimation.external_wrench import ExternalWrench
from hil.loop.sight import AGREED_m, Sight
from tests.records import record_of

ALL = 0b111111
TURNED = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


@pytest.fixture(scope="module")
def parts() -> Any:
    return build_cycle(load("virtual"), 1000.0, 0.01).parts


class Hearing:
    """Takes in the wrench sensor. State: what it heard last."""

    last = np.zeros(6)

    def hear(self, tick: int, values: Any, R: Any) -> None:
        self.heard = tick, values, np.array(R)


class Fusing:
    """A filter that finds what it is told."""

    def __init__(self) -> None:
        self.R, self.p = TURNED, np.array([0.1, 0.2, 0.9])
        self.legs, self.residual = ALL, 0.0

    def estimate(self, tick: Any, *others: Any) -> None:
        self.wrench = others[-1].copy()
        tick["p"], tick["R"] = self.p, self.R
        tick["legs_used"], tick["fk_residual"] = self.legs, self.residual


def hear(sight: Sight, readings: Readings, **columns: Any) -> Any:
    tick = record_of(tick=5, **columns)
    sensors = SimpleNamespace(decode=lambda *_: readings)
    sight.hear(sensors, SimpleNamespace(frames=(), tick=5), tick)  # type: ignore[arg-type]
    return tick


def test_refused_frames_of_sensors_come_to_those_of_drives_and_stand_apart(parts):
    tick = hear(Sight(parts), Readings(rejected=2), rejected=3)
    assert (int(tick["rejected"]), int(tick["sensors_rejected"])) == (5, 2)


@pytest.mark.parametrize("fusing", [True, False])
def test_the_newest_sample_of_the_load_counts_turned_by_the_pose_as_it_is_seen_now(parts, fusing):
    hearing = Hearing()
    sight = Sight(replace(parts, wrench=hearing, fusion=Fusing()))
    sight.fusing = fusing
    samples = tuple(Sample(4, 1e-4 * k, (float(k),) * 6) for k in range(3))
    hear(sight, Readings(wrench=samples))
    tick, values, R = hearing.heard
    assert (tick, tuple(values)) == (5, (2.0,) * 6)
    np.testing.assert_array_equal(R, TURNED if fusing else parts.home_R)


@pytest.mark.parametrize("source", ["sensor", "observer"])
def test_the_fused_pose_is_told_of_the_load_of_the_last_tick_whoever_saw_it(parts, source):
    seen = np.array([100.0, -200.0, 300.0, 10.0, -20.0, 30.0])
    watching: Any = SimpleNamespace(observe=lambda *_, **__: seen, reset=lambda: None)
    wrench = ExternalWrench(watching if source == "observer" else None, 1000.0, 1e-3)
    fusing = Fusing()
    fusing.R = np.eye(3)
    sight = Sight(replace(parts, wrench=wrench, fusion=fusing))
    sight.located = sight.fusing = True
    told = []
    for n in range(2):
        tick = hear(sight, Readings(wrench=(Sample(4, 0.0, tuple(seen)),) if n == 0 else ()), age=0)
        sight.estimate(tick, record_of(), 0)
        told.append(fusing.wrench)
        wrench.fill(tick, fusing=True)
        np.testing.assert_array_equal(tick["wrench"], seen)
    np.testing.assert_array_equal(told, [np.zeros(6), seen])


@pytest.mark.parametrize(
    ("legs", "residual", "agreed"),
    [(ALL, 0.9 * AGREED_m, True), (ALL, 1.1 * AGREED_m, False), (0b111101, 0.0, False)],
)
def test_the_legs_go_on_alone_only_from_a_pose_that_all_six_agreed_on(parts, legs, residual, agreed):
    fusing = Fusing()
    fusing.legs, fusing.residual = legs, residual
    sight = Sight(replace(parts, wrench=Hearing(), fusion=fusing))
    sight.located = sight.fusing = True
    tick = record_of(tick=5, age=0, length=1.5)
    sight.estimate(tick, record_of(), 0)
    np.testing.assert_array_equal(sight.estimator.p, fusing.p if agreed else parts.home_p)
    np.testing.assert_array_equal(tick["p"], fusing.p)
