"""Which part of a cycle gets what of a configuration, at the configured rate and at another one."""

from __future__ import annotations

from math import exp, pi
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from hil.app import compose
from hil.app.compose import build_cycle, drive_setup
from hil.app.configuration.configuration import Configuration
from hil.app.encoder_limits import Noise
from hil.config.delay import DelayCompensation
from hil.config.estimation import EstimationSettings, FusionSettings
from hil.config.model import ModelSettings
from hil.config.wrench import WrenchSettings
from hil.control.law import LawContext
from hil.control.model import build_model
from hil.control.pose_inverse_dynamics import PoseInverseDynamicsSettings
from hil.design.stability.monitor import build_watch
from hil.robot.dynamics import Model
from hil.trajectory.holding import HoldTrajectory
from hil.trajectory.override import PEAK
from tests.hil.cycle_bench import VIRTUAL

POSE = PoseInverseDynamicsSettings(law="pose_inverse_dynamics", wn_rad_s=20.0)
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
    path = predictor.path
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
    path = observer.path
    assert (path.period_s, path.transport_s, path.lag_s) == pytest.approx((0.002, 0.4e-3, 0.9e-3))
    assert observer.record["left"] == pytest.approx(exp(-2.0 * pi * 5.0 * 0.002))


def test_law_observer_and_filter_each_believe_the_model_of_their_own_section(monkeypatch):
    of = {scale: ModelSettings(inertia_scale=scale) for scale in (0.7, 0.8, 0.9)}
    wrench = WrenchSettings(source="observer", model=of[0.8])
    estimation = EstimationSettings.model_construct(
        pose="fused", wrench=wrench, fusion=FusionSettings(model=of[0.9])
    )
    law = VIRTUAL.controller.model_copy(update={"model": of[0.7], "delay_compensation": AHEAD})
    made: dict[float, Model] = {}

    def noted(settings: ModelSettings, *where: Any) -> Model:
        made[settings.inertia_scale] = build_model(settings, *where)
        return made[settings.inertia_scale]

    monkeypatch.setattr(compose, "build_model", noted)
    parts: Any = build_cycle(but(controller=law, estimation=estimation), 1000.0, 0.01).parts
    believed = (parts.predictor.model, parts.wrench.observer.model, parts.fusion._model)
    assert [model is made[scale] for model, scale in zip(believed, of, strict=True)] == [True] * 3


def test_a_jog_is_admitted_by_what_starts_and_stops_it_at_set_up_speed():
    operator = VIRTUAL.operator.model_copy(update={"setup_speed_m_s": 0.02, "setup_speed_deg_s": 3.0})
    engage = VIRTUAL.engage.model_copy(update={"stop_s": 0.8})
    admission = build_cycle(but(operator=operator, engage=engage), 1000.0, 0.01).parts.admission
    expected = PEAK / 0.8 * np.array([0.02, 0.02, 0.02, *[3.0 * pi / 180.0] * 3])
    np.testing.assert_allclose(admission._record["ddchi"], expected, rtol=1e-12)
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


def watched(monkeypatch: pytest.MonkeyPatch, c: Configuration, rate_Hz: float) -> tuple[Any, ...]:
    """What the watch of the certificate is made from, payload and noise being known."""
    told: list[tuple[Any, ...]] = []
    payload = SimpleNamespace(
        allowed=lambda monitor: monitor.model_copy(update={"disturbance_m_s2": 7.0}),
        allowed_of_the_pose=lambda monitor: monitor.model_copy(update={"disturbance_m_s2": 8.0}),
    )
    noise = {500.0: Noise(3e-5, 4e-3), 1000.0: Noise(1e-5, 2e-3), 2000.0: Noise(2e-5, 3e-3)}
    monkeypatch.setattr(compose, "unknown_payload", lambda _: payload)
    monkeypatch.setattr(compose, "read_noise", lambda _, rate_Hz: noise[rate_Hz])
    monkeypatch.setattr(compose, "build_watch", lambda *what: told.append(what) or build_watch(*what))  # type: ignore[func-returns-value]
    build_cycle(c, rate_Hz, 0.01)
    (what,) = told
    return what


@pytest.mark.parametrize(("law", "disturbance"), [(VIRTUAL.controller, 7.0), (POSE, 8.0)])
def test_what_an_unknown_payload_may_do_is_allowed_in_the_axes_of_the_law(monkeypatch, law, disturbance):
    assert watched(monkeypatch, but(controller=law), 1000.0)[0].disturbance_m_s2 == disturbance


@pytest.mark.parametrize(("rate_Hz", "noise"), [(500.0, (3e-5, 4e-3)), (1000.0, (1e-5, 2e-3))])
def test_the_certificate_is_watched_with_the_noise_that_readings_have_at_that_rate(
    monkeypatch, rate_Hz, noise
):
    monitor = watched(monkeypatch, VIRTUAL, rate_Hz)[0]
    assert (monitor.length_noise_m, monitor.rate_noise_m_s) == noise
