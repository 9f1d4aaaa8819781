"""What is heard of sensors in a tick, and from which pose the legs go on alone."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from drivers.sensors import Readings, Sample
from drivers.signals import DriveState
from hil.app.compose import build_cycle
from hil.app.configuration.configuration import load
from hil.estimation.external_wrench import ExternalWrench
from hil.estimation.observer import WrenchObserver
from hil.loop.sight import AGREED_m, Sight
from hil.robot.dynamics import Model
from hil.robot.force_path import ForcePath
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

    def estimate(self, tick: Any, latched_ns: int, readings: Readings, tau: Any, wrench: Any) -> None:
        self.told, self.wrench = (latched_ns, readings, tau.tolist()), wrench.copy()
        tick["p"], tick["R"] = self.p, self.R
        tick["legs_used"], tick["fk_residual"] = self.legs, self.residual


def hear(sight: Sight, readings: Readings, **columns: Any) -> Any:
    tick = record_of(tick=5, **columns)
    sensors = SimpleNamespace(decode=lambda *_: readings)
    sight.hear(sensors, SimpleNamespace(frames=(), tick=5), tick)  # type: ignore[arg-type]
    return tick


def see(sight: Sight, tick: Any, last: Any = None) -> None:
    """Fill the estimate of a tick, as the cycle has it filled."""
    tick["q"], tick["dq"] = tick["length"], tick["rate"]
    if not sight.located:
        sight.locate(tick)
    elif sight.parts.fusion is not None:
        sight.fuse(tick, record_of() if last is None else last)
    else:
        sight.update(tick)


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
    watching = WrenchObserver(Model(parts.platform), ForcePath(1e-3, 0.0, 0.0), 20.0)
    wrench = ExternalWrench(watching if source == "observer" else None, 1000.0, 1e-3)
    watching.residual[:] = seen
    fusing = Fusing()
    fusing.R = np.eye(3)
    sight = Sight(replace(parts, wrench=wrench, fusion=fusing))
    sight.located = sight.fusing = True
    told = []
    for n in range(2):
        tick = hear(sight, Readings(wrench=(Sample(4, 0.0, tuple(seen)),) if n == 0 else ()), age=0)
        see(sight, tick)
        told.append(fusing.wrench)
        tick["drive_state"] = DriveState.READY  # a brake is shut: what was seen before stays
        wrench.fill(tick, fusing=True)
        np.testing.assert_array_equal(tick["wrench"], seen)
    np.testing.assert_array_equal(told, [np.zeros(6), seen])


@pytest.mark.parametrize(
    ("legs", "residual", "agreed"),
    [(ALL, 0.999 * AGREED_m, True), (ALL, AGREED_m, False), (0b111101, 0.0, False)],
)
def test_the_legs_go_on_alone_only_from_a_pose_that_all_six_agreed_on(parts, legs, residual, agreed):
    fusing = Fusing()
    fusing.legs, fusing.residual = legs, residual
    sight = Sight(replace(parts, wrench=Hearing(), fusion=fusing))
    sight.located = sight.fusing = True
    tick = record_of(tick=5, age=0, length=1.5, t_ns=1000, lateness_ns=200, latch_ns=[0, 39, 34, 50, 0, 34])
    sight.readings = Readings(rejected=3)
    see(sight, tick, record_of(tau=[1.0, 2.0, 3.0, 4.0, 5.0, 6.0]))
    assert fusing.told == (1234, Readings(rejected=3), [1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
    np.testing.assert_array_equal(sight.estimator.p, fusing.p if agreed else parts.home_p)
    np.testing.assert_array_equal(sight.estimator.R, TURNED if agreed else parts.home_R)
    np.testing.assert_array_equal(tick["p"], fusing.p)


def test_the_sensors_decode_the_frames_of_the_tick_beside_what_they_said_before(parts):
    sight, told, said = Sight(parts), list[Any](), [Readings(rejected=1), Readings(rejected=2)]

    def decode(*what: Any) -> Readings:
        told.append(what)
        return said[len(told) - 1]

    sensors: Any = SimpleNamespace(decode=decode)
    for n in range(2):
        inp: Any = SimpleNamespace(frames=(n, 9), tick=5 + n)
        sight.hear(sensors, inp, record_of(tick=5 + n))
    assert told == [((0, 9), 5, Readings()), ((1, 9), 6, said[0])]
    assert sight.readings is said[1]


# -- the first pose


class Looking:
    """An estimator that finds the pose when it is told to. State: which lengths it was asked about."""

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


@pytest.mark.parametrize(("rate_Hz", "every"), [(1000.0, 20), (400.0, 8), (250.0, 6), (100.0, 6)])
def test_the_first_pose_is_looked_for_every_20_ms_but_not_in_more_than_one_tick_of_six(parts, rate_Hz, every):
    sight, looks = looking(parts, rate_Hz)
    for number in range(1, 4 * every + 1):
        see(sight, record_of(tick=number, age=0, length=float(number)))
    assert looks.asked == [every, 2 * every, 3 * every, 4 * every]


@pytest.mark.parametrize("leg", [0, 3, 5])
def test_a_look_that_is_due_waits_for_a_tick_in_which_all_six_were_heard(parts, leg):
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
    assert sight.in_time == [27 if k == leg else 30 for k in range(6)]


def test_a_pose_that_was_found_is_followed_from_that_tick_on_and_looked_for_no_more(parts):
    sight, looks = looking(parts)
    for number in range(40, 100):
        looks.finds = number >= 60
        tick = record_of(tick=number, age=0)
        see(sight, tick)
        assert sight.located is (number >= 60)
        assert (float(tick["p"][0]) == 7.0) is (number >= 60)
    assert len(looks.asked) == 2


@pytest.mark.parametrize("leg", range(6))
def test_a_leg_that_was_not_heard_is_carried_on_at_its_last_rate_over_its_own_age(parts, leg):
    sight, _ = looking(parts)
    sight.located = True
    rates, ages = 0.1 * (1.0 + np.arange(6)), (3 + leg) * (np.arange(6) == leg)
    tick = record_of(tick=9, length=1.5, rate=rates, age=ages)
    see(sight, tick)
    np.testing.assert_allclose(tick["q"], 1.5 + 1e-3 * rates * ages, rtol=0.0, atol=1e-15)
    np.testing.assert_array_equal(tick["dq"], rates)
    np.testing.assert_array_equal(tick["length"], np.full(6, 1.5))


def test_the_filter_begins_at_the_pose_of_the_legs_and_fills_the_ticks_that_follow(parts):
    begun: list[Any] = []
    fusing: Any = Fusing()
    fusing.start = lambda number, ns, p, R: begun.append((number, ns, p.copy(), R.copy()))
    sight, looks = looking(replace(parts, wrench=Hearing(), fusion=fusing))
    looks.finds = True
    ticks = [record_of(tick=number, age=0, length=1.5, t_ns=1234) for number in (20, 21)]
    for tick in ticks:
        see(sight, tick)
        assert sight.fusing
    assert begun[0][:2] == (20, 1234)
    np.testing.assert_array_equal(begun[0][2], ticks[0]["p"])
    np.testing.assert_array_equal(begun[0][3], ticks[0]["R"])
    assert len(begun) == 1
    np.testing.assert_array_equal([ticks[0]["p"], ticks[1]["p"]], [np.full(3, 7.0), fusing.p])


def test_forgotten_it_looks_from_the_last_pose_and_after_a_reset_from_home(parts):
    sight = Sight(parts)
    p = parts.home_p + 0.1
    for back, stays in ((sight.forget, True), (sight.reset, False)):
        sight.estimator.adopt(p, TURNED)
        sight.located = sight.sought = sight._due = sight.fusing = True
        sight.in_time, sight.readings = [4] * 6, Readings(rejected=3)
        back()
        assert [sight.located, sight.sought, sight._due, sight.fusing] == [False] * 4
        assert sight.in_time == [None] * 6
        assert (sight.readings == Readings()) is not stays
        np.testing.assert_array_equal(sight.estimator.p, p if stays else parts.home_p)
        np.testing.assert_array_equal(sight.estimator.R, TURNED if stays else parts.home_R)
