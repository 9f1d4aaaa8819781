"""The wrench observer in the closed loop, on the bus of configs/virtual.yaml.

Without it, the error under a load follows from the error dynamics: M J^-1 wn^2 e = J^T-transformed load, so e
= J M^-1 wrench / wn^2.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from drivers.signals import Mode
from hil.app.configuration.configuration import Configuration, load
from hil.app.configuration.platform import build_platform
from hil.robot.dynamics import Model
from hil.robot.kinematics import jacobian
from plant_fmu.faults.kinds import WrenchStep
from tests.broad import broad
from tests.loop.bench import changed, succeeded

HOLD = {"type": "hold", "duration_s": 1.25}
LOAD = (1000.0, 0.0, 0.0, 0.0, 0.0, 0.0)
START_S = 1.5
"""A quarter of a second after tracking begins; before, the estimate must be zero."""
STEP = WrenchStep(at_s=START_S, force_N=LOAD[:3], moment_N_m=LOAD[3:])


def bench(reference: Any = HOLD, scale: float = 1.0, **wrench: Any) -> Configuration:
    model = {"inertia_scale": scale}
    observer = {
        "source": "observer",
        "bandwidth_Hz": 15.0,
        "bus_ms": 0.5,
        "drive_lag_ms": 0.796,
        "model": model,
    }
    sections: dict[str, Any] = {"estimation": {"wrench": observer | wrench}, "reference": reference}
    if wrench.get("source") == "sensor":
        sections["sensors"] = {"wrench": {"rate_Hz": 1000}}
    return changed("virtual", controller={"model": model}, **sections)


def final_error(rows):
    """Leg errors (6,) m, mean of the last 0.2 s of the hold."""
    last = rows[rows["mode"] == Mode.TRACKING][-200:]
    return (last["q_d"] - last["q"]).mean(axis=0)


@pytest.fixture(scope="module")
def held() -> dict[str, Any]:
    return {source: succeeded(bench(source=source), STEP).rows for source in ("observer", "sensor", "none")}


def test_wrench_observer_estimates_a_step_of_1_kN_within_5_percent_after_50_ms(held):
    rows = held["observer"]
    t = rows["t_ns"] * 1e-9
    wrench = rows["wrench"]
    assert np.abs(wrench[t < START_S]).max() < 2.0
    after = (t >= START_S + 0.05) & (rows["mode"] == Mode.TRACKING)
    assert after.sum() > 300
    assert np.abs(wrench[after, 0] - 1000.0).max() < 50.0
    assert np.abs(wrench[after, 1:]).max() < 50.0


def test_load_measured_by_a_sensor_before_the_brakes_open_causes_no_bump():
    """The ramp ends at the static force that holds platform and load."""
    first = WrenchStep(at_s=0.0, force_N=LOAD[:3], moment_N_m=LOAD[3:])
    loaded = succeeded(bench(source="sensor"), first).rows
    last = loaded[loaded["mode"] == Mode.LOADING][-1]
    platform = build_platform(load("virtual").platform)
    on_platform = jacobian(platform, last["p"], last["R"].reshape(3, 3)).T @ last["tau"]
    assert on_platform[0] == pytest.approx(-1000.0, abs=5.0)
    free = loaded[np.isin(loaded["mode"], [Mode.RELEASING, Mode.APPROACH, Mode.TRACKING])]
    assert np.abs(free["q_d"] - free["q"]).max() < 5e-6
    moving = loaded[(loaded["mode"] >= Mode.LOADING) & (loaded["mode"] <= Mode.TRACKING)]
    assert np.abs(np.diff(moving["tau"], axis=0)).max() < 50.0
    assert np.abs(moving["q_d"] - moving["q"]).max() < 20e-6


@pytest.mark.parametrize("source", ["observer", "sensor"])
def test_feedback_of_the_estimated_or_measured_wrench_removes_the_static_pose_error(held, source):
    without, fed_back = final_error(held["none"]), final_error(held[source])
    c = load("virtual")
    platform = build_platform(c.platform)
    home, level = np.array(c.platform.home.position_m), np.eye(3)
    M = Model(platform).mass_matrix(home, level)
    expected = -jacobian(platform, home, level) @ np.linalg.solve(M, np.array(LOAD)) / 20.0**2
    np.testing.assert_allclose(without, expected, rtol=0.01, atol=2e-6)
    assert np.abs(fed_back).max() < 0.1 * np.abs(without).max()


BOOK = {"periods": 1}


def test_delay_that_is_not_configured_appears_as_a_load_in_the_wrench_observer():
    rows = succeeded(bench(BOOK, bus_ms=0.0, drive_lag_ms=0.0)).rows
    assert np.abs(rows["wrench"]).max() > 50.0


@pytest.mark.parametrize(
    ("bandwidth_Hz", "scale", "known"),
    broad([(100.0, 1.6, True), (100.0, 1.0, False), (15.0, 0.6, True)], quick=1),
)
def test_wrench_feedback_is_stable_with_wrong_masses_and_delays(bandwidth_Hz, scale, known):
    """Masses of 0.6 to 1.6 times the true ones in law and observer, or unconfigured delays, up to 100 Hz."""
    delays: dict[str, Any] = {} if known else {"bus_ms": 0.0, "drive_lag_ms": 0.0}
    rows = succeeded(bench(scale=scale, bandwidth_Hz=bandwidth_Hz, **delays), STEP).rows
    last = rows[rows["mode"] == Mode.TRACKING][-200:]
    assert np.ptp(last["tau"], axis=0).max() < 5.0, "the forces are at rest"
    assert np.abs(last["q_d"] - last["q"]).max() < 3e-6
    entry = rows[np.isin(rows["mode"], [Mode.RELEASING, Mode.APPROACH])]
    assert np.abs(entry["q_d"] - entry["q"]).max() < 20e-6, "wrong masses make no bump at the entry"


def test_wrench_estimate_is_kept_until_the_brakes_are_closed(held):
    rows = held["observer"]
    parking, powered = rows["mode"] == Mode.PARKING, np.isin(rows["mode"], [Mode.PARKING, Mode.UNLOADING])
    assert np.abs(np.diff(rows["tau"][parking], axis=0)).max() < 10.0
    assert np.abs(rows["wrench"][powered, 0] - 1000.0).max() < 5.0
    assert not rows["wrench"][-1].any()
    loading = np.isin(rows["mode"], [Mode.WAITING, Mode.IDLE, Mode.LOADING])
    assert not rows["wrench"][loading].any()
