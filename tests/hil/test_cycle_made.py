"""Which part of a cycle gets what of a configuration, at the configured rate and at another one."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from hil.app import compose
from hil.app.compose import build_cycle, drive_setup
from hil.app.configuration.configuration import Configuration
from hil.app.encoder_limits import Noise
from hil.config.delay import DelayCompensation
from hil.control.pose_inverse_dynamics import PoseInverseDynamicsSettings
from hil.design.stability.monitor import build_watch
from hil.trajectory.holding import HoldTrajectory
from tests.hil.cycle_bench import VIRTUAL

POSE = PoseInverseDynamicsSettings(law="pose_inverse_dynamics", wn_rad_s=20.0)
AHEAD = DelayCompensation(bus_ms=0.3, drive_lag_ms=0.8, hold_ms=0.5)
LAW = VIRTUAL.controller.model_copy(update={"delay_compensation": AHEAD})


def but(**changes: Any) -> Configuration:
    return VIRTUAL.model_copy(update=changes)


@pytest.mark.parametrize(("rate_Hz", "share"), [(500.0, 2.0), (1000.0, 1.0), (2000.0, 0.5)])
def test_a_force_may_change_as_much_in_a_second_at_any_rate(rate_Hz, share):
    limits = build_cycle(VIRTUAL, rate_Hz, 0.01).parts.safety.limits
    assert limits["force_step_N"] == pytest.approx(share * VIRTUAL.limits.force_step_N)
    assert limits["force_window_N"] == VIRTUAL.limits.force_window_N


@pytest.mark.parametrize("watchdog_s", [0.003, 0.5])
def test_a_watchdog_that_is_given_is_set_in_the_drives_and_else_the_configured_one(watchdog_s):
    assert build_cycle(VIRTUAL, 1000.0, watchdog_s).parts.setup.watchdog_s == watchdog_s
    assert drive_setup(VIRTUAL, 1000.0).watchdog_s == pytest.approx(1e-3 * VIRTUAL.drives.watchdog_ms)


def test_forces_that_were_learned_for_the_reference_do_not_act_on_another_one(monkeypatch):
    monkeypatch.setattr(compose, "learned_forces", lambda *_: "learned")
    monkeypatch.setattr(compose, "Cycle", lambda parts: parts)
    other = HoldTrajectory(np.zeros(3), np.eye(3))
    given: Any = build_cycle(VIRTUAL, 1000.0, 0.01, trajectory=other)
    own: Any = build_cycle(VIRTUAL, 1000.0, 0.01)
    assert (given.trajectory, given.learned, own.learned) == (other, None, "learned")


@pytest.mark.parametrize(
    ("law", "rate_Hz", "disturbance", "noise"),
    [(VIRTUAL.controller, 500.0, 7.0, (3e-5, 4e-3)), (POSE, 1000.0, 8.0, (1e-5, 2e-3))],
)
def test_the_certificate_is_watched_in_the_axes_of_the_law_with_payload_and_noise(
    monkeypatch, law, rate_Hz, disturbance, noise
):
    watched: list[tuple[Any, ...]] = []
    payload = SimpleNamespace(
        allowed=lambda monitor: monitor.model_copy(update={"disturbance_m_s2": 7.0}),
        allowed_of_the_pose=lambda monitor: monitor.model_copy(update={"disturbance_m_s2": 8.0}),
    )

    def build(*what: Any) -> Any:
        watched.append(what)
        return build_watch(*what)

    of = {500.0: Noise(3e-5, 4e-3), 1000.0: Noise(1e-5, 2e-3)}
    monkeypatch.setattr(compose, "unknown_payload", lambda _: payload)
    monkeypatch.setattr(compose, "read_noise", lambda _, rate_Hz: of[rate_Hz])
    monkeypatch.setattr(compose, "build_watch", build)
    build_cycle(but(controller=law), rate_Hz, 0.01)
    ((monitor, *_, delay_ticks, _lag_s),) = watched
    assert monitor.disturbance_m_s2 == disturbance
    assert (monitor.length_noise_m, monitor.rate_noise_m_s) == noise
    assert delay_ticks == 1, "a command takes one period at most, however long that is"
