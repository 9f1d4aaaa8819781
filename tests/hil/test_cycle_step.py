"""Data between the stages of a step, parts of a cycle, and its reset."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from drivers.arrays import ZERO6
from drivers.signals import Mode, Warn
from hil.app import compose
from hil.app.compose import build_cycle, drive_setup
from hil.app.derive_encoder_limits import Noise
from hil.control.pose_inverse_dynamics import PoseInverseDynamicsSettings
from hil.design.stability.monitor import build_watch
from hil.loop.cycle import Cycle
from hil.loop.homing import LastPose
from hil.robot.kinematics import leg_lengths
from tests.hil.cycle_bench import BRISK, HIGHER, LIVE, VIRTUAL, Bench, aside, held_to

ASKED = np.array([11.0, -12.0, 13.0, -14.0, 15.0, -16.0])
LENIENT = VIRTUAL.limits.model_copy(update={"following_error_m": 10.0})


class Law:
    """A law with a constant force. State: the last shortfall."""

    shortfall = ZERO6

    def reset(self) -> None:
        """Nothing to reset."""

    def effort(self, tick: Any) -> None:
        self.shortfall = tick["shortfall"].copy()
        tick["tau_law"] = ASKED


def a_bench(**parts: Any) -> Bench:
    """A bench just before tick 50 that stays in its mode, with a live reference and a constant law."""
    c = VIRTUAL.model_copy(update={"reference": LIVE, "limits": LENIENT})
    bench = Bench(cycle=Cycle(replace(build_cycle(c, 1000.0, 0.01).parts, **{"law": Law()} | parts)))
    for _ in range(50):
        bench.step()
    bench.cycle._change_mode = lambda *_: None  # type: ignore[method-assign]
    return bench


@pytest.fixture
def bench() -> Bench:
    return a_bench()


def step(bench: Bench, mode: Mode, **changes: Any) -> Any:
    """Row of the next tick, in a given mode."""
    bench.cycle.mode = mode
    bench.cycle.control.settle()
    return bench.step(**changes).row


@pytest.mark.parametrize("mode", [Mode.APPROACH, Mode.TRACKING, Mode.STOPPING, Mode.PARKING])
@pytest.mark.parametrize("elsewhere", [False, True])
@pytest.mark.parametrize("what", ["goes", "on hold", "parks"])
def test_a_live_reference_takes_set_points_and_advances_only_if_tracked(
    bench, monkeypatch, mode, elsewhere, what
):
    taken: list[Any] = []
    cycle = bench.cycle
    steering: Any = cycle.parts.steering
    live = steering.trajectory
    live.reset()
    monkeypatch.setattr(steering, "take", lambda points, *, tracking: taken.append(tracking))
    if elsewhere:
        cycle.motion.rest(aside(cycle), cycle.parts.home_R, 20)
    else:
        cycle.motion.start(live, 20)
    cycle.operating.go, cycle.operating.parks = what != "on hold", what == "parks"
    step(bench, mode, setpoints=(HIGHER,))
    assert taken == [mode is Mode.TRACKING and what == "goes"]
    under_way = mode in {Mode.TRACKING, Mode.STOPPING} and not elsewhere
    assert int(live._live["tick"]) == (30 if under_way else 0)


@pytest.mark.parametrize("mode", [Mode.APPROACH, Mode.TRACKING, Mode.STOPPING])
@pytest.mark.parametrize("away", [False, True])
def test_the_law_gets_the_reference_time_only_while_on_the_reference(bench, mode, away):
    cycle = bench.cycle
    cycle.motion.rest(aside(cycle), cycle.parts.home_R, 20)
    if away:
        cycle.motion._left = cycle.parts.trajectory, 0.0
    row = step(bench, mode)
    assert row["reference_time_s"] == pytest.approx(0.03)
    if mode is Mode.TRACKING and not away:
        assert cycle.tick["t_d"] == row["reference_time_s"]
    else:
        assert np.isnan(cycle.tick["t_d"])


@pytest.mark.parametrize("mode", list(Mode))
def test_the_reference_is_the_measured_pose_unless_legs_follow_the_motion(bench, mode):
    cycle = bench.cycle
    cycle.motion.rest(aside(cycle), cycle.parts.home_R, 20)
    row = step(bench, mode)
    follows = mode not in {Mode.WAITING, Mode.IDLE, Mode.LOADING, Mode.PARKED, Mode.FAULT}
    np.testing.assert_array_equal(row["p_d"], aside(cycle) if follows else row["p"])
    assert not cycle.tick["twist_d"].any()


@pytest.mark.parametrize(
    ("mode", "limit_N", "limited"),
    [
        (Mode.TRACKING, 10.0, True),
        (Mode.HELD, 10.0, True),
        (Mode.TRACKING, 100.0, False),
        (Mode.LOADING, 10.0, False),
    ],
)
def test_law_receives_the_shortfall_of_limited_forces_only_while_it_acts(bench, mode, limit_N, limited):
    cycle = bench.cycle
    cycle.effort.holding, cycle.mode_tick = ASKED, -100_000
    with held_to(bench, force_N=limit_N):
        warnings = int(step(bench, mode)["warnings"])
    assert bool(warnings & Warn.FORCE_LIMIT) == (limit_N < 11.0)
    step(bench, Mode.TRACKING)
    kept = np.clip(ASKED, -limit_N, limit_N) - ASKED if limited else ZERO6
    np.testing.assert_array_equal(cycle.parts.law.shortfall, kept)
    cycle.reset()
    assert not cycle.control.record["shortfall"].any()


@pytest.mark.parametrize("mode", list(Mode))
@pytest.mark.parametrize("proven", [False, True])
def test_a_leg_with_its_drive_off_counts_as_braked_if_brakes_are_proven(mode, proven):
    parts = build_cycle(VIRTUAL, 1000.0, 0.01).parts
    length, step_m = leg_lengths(parts.platform, parts.home_p, parts.home_R), np.full(6, 0.01)
    bench = a_bench(last_pose=LastPose(length, step_m, step_m, step_m, "parked", "hil homing"))
    bench.cycle.proven = proven
    bench.drives.length = length - step_m * (np.arange(6) == 4)
    step(bench, mode)
    assert bench.cycle.homing.known == proven
    assert bool(bench.cycle.homing.refusal) != proven
    assert (bench.cycle.tick["length"][4] == pytest.approx(length[4], abs=1e-6)) == proven


# -- what a cycle is made of


def test_motor_turns_lost_before_brakes_open_are_restored_and_later_ones_refused():
    made = build_cycle(VIRTUAL.model_copy(update={"engage": BRISK}), 1000.0, 0.01).parts
    true, step_m = leg_lengths(made.platform, made.home_p, made.home_R), np.full(6, 0.01)
    pose = LastPose(true, np.full(6, 1e-4), step_m, step_m, "parked", "hil homing")
    bench = Bench(cycle=Cycle(replace(made, last_pose=pose)))
    bench.drives.length = true - step_m * np.array([1, 2, 3, 4, 5, 6])
    bench.until(Mode.RELEASING)
    homing = bench.cycle.homing
    np.testing.assert_allclose(bench.cycle.tick["length"], true, rtol=0.0, atol=1e-6)
    np.testing.assert_allclose(homing.raw, bench.drives.length, rtol=0.0, atol=1e-6)
    assert (homing.known, homing.opened) == (True, False)
    bench.step()
    assert homing.opened
    bench.drives.length = bench.drives.length + step_m * (np.arange(6) == 4)
    bench.step()
    assert "leg 4" in homing.refusal


# -- what of a configuration comes to which part


POSE = PoseInverseDynamicsSettings(law="pose_inverse_dynamics", wn_rad_s=20.0)


@pytest.mark.parametrize(("rate_Hz", "share"), [(500.0, 2.0), (1000.0, 1.0), (2000.0, 0.5)])
def test_the_limit_of_force_change_per_second_is_the_same_at_any_rate(rate_Hz, share):
    limits = build_cycle(VIRTUAL, rate_Hz, 0.01).parts.safety.limits
    assert limits["force_step_N"] == pytest.approx(share * VIRTUAL.limits.force_step_N)
    assert limits["force_window_N"] == VIRTUAL.limits.force_window_N


@pytest.mark.parametrize("watchdog_s", [0.003, 0.5])
def test_drives_get_the_watchdog_time_of_the_run_or_else_the_configured_one(watchdog_s):
    assert build_cycle(VIRTUAL, 1000.0, watchdog_s).parts.setup.watchdog_s == watchdog_s
    assert drive_setup(VIRTUAL, 1000.0).watchdog_s == pytest.approx(1e-3 * VIRTUAL.drives.watchdog_ms)


@pytest.mark.parametrize(
    ("law", "rate_Hz", "disturbance", "noise"),
    [(VIRTUAL.controller, 500.0, 7.0, (3e-5, 4e-3)), (POSE, 1000.0, 8.0, (1e-5, 2e-3))],
)
def test_lyapunov_monitor_uses_the_axes_of_the_law_the_payload_and_the_noise(
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
    build_cycle(VIRTUAL.model_copy(update={"controller": law}), rate_Hz, 0.01)
    ((monitor, *_, delay_ticks, _lag_s),) = watched
    assert monitor.disturbance_m_s2 == disturbance
    assert (monitor.length_noise_m, monitor.rate_noise_m_s) == noise
    assert delay_ticks == 1, "a command takes one period at most, however long that is"
