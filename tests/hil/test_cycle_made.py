"""What of a configuration comes to which part of a cycle, at the configured rate and at another one."""

from __future__ import annotations

from math import exp, pi
from typing import Any

import numpy as np
import pytest

from drivers.config import WrenchSensorSettings
from hil.app import compose
from hil.app.compose import build_cycle, drive_setup
from hil.app.configuration.configuration import Configuration, load
from hil.config.delay import DelayCompensation
from hil.config.estimation import EstimationSettings
from hil.config.wrench import WrenchSettings
from hil.control.law import LawContext
from hil.trajectory.holding import HoldTrajectory
from hil.trajectory.override import PEAK
from tests.hil.test_cycle_again import LIVE

VIRTUAL = load("virtual")
AHEAD = DelayCompensation(bus_ms=0.3, drive_lag_ms=0.8, hold_ms=0.5)


def but(**changes: Any) -> Configuration:
    return VIRTUAL.model_copy(update=changes)


def seeing_ahead() -> Configuration:
    return but(controller=VIRTUAL.controller.model_copy(update={"delay_compensation": AHEAD}))


def contexts_of(c: Configuration, monkeypatch: pytest.MonkeyPatch) -> list[LawContext]:
    """What the law of a configuration is built with from now on."""
    told: list[LawContext] = []
    build = type(c.controller).build

    def noted(settings: Any, context: LawContext) -> Any:
        told.append(context)
        return build(settings, context)

    monkeypatch.setattr(type(c.controller), "build", noted)
    return told


@pytest.mark.parametrize(("rate_Hz", "share"), [(500.0, 2.0), (1000.0, 1.0), (2000.0, 0.5)])
def test_a_force_may_change_as_much_in_a_second_at_whatever_rate(rate_Hz, share):
    limits = build_cycle(VIRTUAL, rate_Hz, 0.01).parts.safety.limits
    assert limits["force_step_N"] == pytest.approx(share * VIRTUAL.limits.force_step_N)
    assert limits["force_window_N"] == VIRTUAL.limits.force_window_N


def test_a_law_that_looks_ahead_does_so_by_bus_lag_and_hold_and_its_reference_too(monkeypatch):
    c = seeing_ahead()
    told = contexts_of(c, monkeypatch)
    predictor = build_cycle(c, 500.0, 0.01).parts.predictor
    assert predictor is not None
    assert predictor.horizon_s == pytest.approx(1.6e-3)
    path = predictor._path
    assert (path.period_s, path.transport_s, path.lag_s) == pytest.approx((0.002, 0.3e-3, 0.8e-3))
    assert [(each.preview_s, each.period_s) for each in told] == [(predictor.horizon_s, 0.002)]
    told.clear()
    assert build_cycle(VIRTUAL, 500.0, 0.01).parts.predictor is None
    assert [each.preview_s for each in told] == [0.0]


def test_what_the_observer_believes_of_the_force_and_how_fast_it_is_come_from_its_own_section():
    wrench = WrenchSettings(source="observer", bandwidth_Hz=5.0, bus_ms=0.4, drive_lag_ms=0.9)
    c = seeing_ahead().model_copy(update={"estimation": EstimationSettings(wrench=wrench)})
    observer = build_cycle(c, 500.0, 0.01).parts.wrench.observer
    assert observer is not None
    path = observer._path
    assert (path.period_s, path.transport_s, path.lag_s) == pytest.approx((0.002, 0.4e-3, 0.9e-3))
    assert observer._left == pytest.approx(exp(-2.0 * pi * 5.0 * 0.002))


@pytest.mark.parametrize("source", ["none", "observer", "sensor"])
def test_a_wrench_sensor_that_is_there_is_the_source_only_where_it_is_said_to_be(source):
    sensors = VIRTUAL.sensors.model_copy(update={"wrench": WrenchSensorSettings(rate_Hz=400.0)})
    c = but(sensors=sensors, estimation=EstimationSettings(wrench=WrenchSettings(source=source)))
    wrench = build_cycle(c, 1000.0, 0.01).parts.wrench
    assert wrench._sensor_rate_Hz == (400.0 if source == "sensor" else None)
    assert (wrench.observer is not None) == (source == "observer")
    assert wrench.has_source == (source != "none")


def test_a_live_reference_is_admitted_by_its_largest_accelerations_and_goes_at_the_rate_of_the_loop():
    parts = build_cycle(but(reference=LIVE), 500.0, 0.01).parts
    limits = LIVE.limits
    radians = np.deg2rad(limits.acceleration_deg_s2)
    expected = np.repeat([limits.acceleration_m_s2, radians], 3)
    np.testing.assert_allclose(parts.admission._limits[0], expected, rtol=1e-12)
    assert parts.trajectory._period == 0.002  # type: ignore[attr-defined]
    assert parts.steering is not None
    assert parts.steering._admission is parts.admission


def test_a_jog_is_admitted_by_what_starts_and_stops_it_at_set_up_speed():
    operator = VIRTUAL.operator.model_copy(update={"setup_speed_m_s": 0.02, "setup_speed_deg_s": 3.0})
    engage = VIRTUAL.engage.model_copy(update={"stop_s": 0.8})
    admission = build_cycle(but(operator=operator, engage=engage), 1000.0, 0.01).parts.admission
    expected = PEAK / 0.8 * np.array([0.02, 0.02, 0.02, *[3.0 * pi / 180.0] * 3])
    np.testing.assert_allclose(admission._limits[0], expected, rtol=1e-12)
    assert admission._stop_s == 0.8


@pytest.mark.parametrize("watchdog_s", [0.003, 0.5])
def test_a_watchdog_that_is_given_is_set_in_the_drives_and_else_that_of_the_configuration(watchdog_s):
    assert build_cycle(VIRTUAL, 1000.0, watchdog_s).parts.setup.watchdog_s == watchdog_s
    assert drive_setup(VIRTUAL, 1000.0).watchdog_s == pytest.approx(1e-3 * VIRTUAL.drives.watchdog_ms)


def test_forces_that_were_learned_for_the_reference_do_not_come_to_another_one(monkeypatch):
    monkeypatch.setattr(compose, "learned_forces", lambda *_: "learned")
    other = HoldTrajectory(np.zeros(3), np.eye(3))
    monkeypatch.setattr(compose, "Cycle", lambda parts: parts)
    given: Any = build_cycle(VIRTUAL, 1000.0, 0.01, trajectory=other)
    own: Any = build_cycle(VIRTUAL, 1000.0, 0.01)
    assert (given.trajectory, given.learned) == (other, None)
    assert own.learned == "learned"


@pytest.mark.parametrize("rate_Hz", [500.0, 1000.0, 2000.0])
def test_as_many_efforts_are_under_way_to_the_drives_at_whatever_rate(monkeypatch, rate_Hz):
    """A command takes one period at most, however long that is."""
    told: list[int] = []
    build = compose.build_watch

    def noted(*what: Any) -> Any:
        told.append(what[5])
        return build(*what)

    monkeypatch.setattr(compose, "build_watch", noted)
    build_cycle(VIRTUAL, rate_Hz, 0.01)
    assert told == [1]
