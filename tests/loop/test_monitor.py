"""The certificate watched in the loop: it alarms for a drive with a wrong sign, and for nothing else.

The book's platform, path and bus. Tracking begins at 0.95 s; the far point of the path follows one second
later.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from drivers.signals import Fault as Faults
from drivers.signals import Mode, Warn
from drivers.tick_columns import ROW
from hil.app.configuration.configuration import Configuration
from hil.app.sim.command import simulate
from hil.loop.run_end import Course
from hil.record.log import Log
from plant_fmu.faults.fault import Fault
from plant_fmu.faults.kinds import DriveSign, WrenchStep
from tests.broad import broad
from tests.loop.bench import bench, changed

SLIDING = {
    "law": "sliding_mode", "lambda_rad_s": 92, "reaching_m_s2": 1,
    "uncertainty": {"disturbance_m_s2": 13, "model_error": 0.1, "acceleration_m_s2": 12},
}  # fmt: skip
POSE = {"law": "pose_inverse_dynamics", "wn_rad_s": 20}
AHEAD = {
    "law": "inverse_dynamics", "wn_rad_s": 90,
    "delay_compensation": {"bus_ms": 0.5, "drive_lag_ms": 0.8, "hold_ms": 0.5},
}  # fmt: skip
LOAD = WrenchStep(at_s=2.2, force_N=(-1.12e3, -6.46e3, 7.55e3), moment_N_m=(0.0, 0.0, 0.0))
"""10 kN in the direction that moves leg 1 most: J M^-1 wrench is 7.7 m/s^2."""


def watched(action: str, disturbance: float = 8.0, name: str = "virtual", **sections: Any) -> Configuration:
    return changed(name, monitor={"action": action, "disturbance_m_s2": disturbance}, **sections)


def run(c: Configuration, *faults: Fault, until_s: float) -> Any:
    """Rows up to an instant, or to a fault."""
    rows: list[Any] = []
    with bench(c, *faults) as lockstep:
        course = Course(lockstep.cycle)
        while len(rows) < round(until_s * c.loop.rate_Hz) and not lockstep.cycle.faults:
            rows.append(lockstep.step(course.commands(lockstep.tick + 1))[2].row.copy())
    return np.array(rows, ROW)


def alarms(rows):
    return int(np.count_nonzero(rows["warnings"] & Warn.CERTIFICATE))


# (instant, legs): the legs that then carry 1 kN or more; a leg carries 1.03 to 16.0 kN
FLIPS = [(1.05, (3,)), (1.25, (1,)), (1.5, (2,)), (1.75, (0,)), (2.25, (4, 5))]


@pytest.mark.parametrize(("start_s", "leg"), broad([(t, leg) for t, legs in FLIPS for leg in legs], quick=2))
def test_lyapunov_monitor_ends_a_run_within_20_ms_after_the_force_sign_of_a_loaded_leg_flips(start_s, leg):
    rows = run(watched("fault"), DriveSign(leg=leg, at_s=start_s), until_s=start_s + 0.05)
    before = rows[np.searchsorted(rows["t_ns"], 1e9 * start_s) - 1]
    assert abs(before["tau"][leg]) > 1000.0
    assert not before["warnings"]
    assert rows["faults"][-1] == Faults.CERTIFICATE, "before any other rule notices"
    assert 0.0 < 1e-9 * rows["t_ns"][-1] - start_s <= 0.020


@pytest.mark.parametrize("controller", [SLIDING, POSE], ids=["sliding mode", "pose"])
def test_lyapunov_monitor_detects_a_flipped_force_sign_under_other_certified_laws(controller):
    rows = run(watched("fault", controller=controller), DriveSign(leg=5, at_s=1.75), until_s=1.8)
    assert rows["faults"][-1] == Faults.CERTIFICATE
    assert 1e-9 * rows["t_ns"][-1] - 1.75 <= 0.020


@pytest.fixture(scope="module")
def nominal(tmp_path_factory):
    """From rest over path, stop and brakes to rest."""
    path = tmp_path_factory.mktemp("monitor") / "nominal.mcap"
    summary = simulate(
        watched("fault", reference={"periods": 1}), log=path, duration_s=2.6, check_replay=True
    )
    return summary, Log.open(path).rows()


def test_lyapunov_function_of_a_nominal_run_stays_far_below_its_bound_and_the_run_replays(nominal):
    summary, rows = nominal
    assert summary["success"], summary
    assert summary["replay"]["different_ticks"] == 0
    assert summary["certificate"]["alarms"] == alarms(rows) == 0
    assert summary["certificate"]["largest_share_percent"] < 60.0
    assert Mode.STOPPING in rows["mode"]
    driving = (rows["mode"] >= Mode.APPROACH) & (rows["mode"] <= Mode.STOPPING)
    for column in ("lyapunov", "lyapunov_rate", "lyapunov_bound", "lyapunov_share"):
        assert np.isfinite(rows[column][driving]).all(), column
        assert np.isnan(rows[column][rows["mode"] < Mode.RELEASING]).all(), column
        assert np.isnan(rows[column][rows["mode"] > Mode.STOPPING]).all(), column


def test_logged_lyapunov_function_is_that_of_the_smallest_reachable_ellipsoid(nominal):
    """At critical damping V = 3/2 wn^2 ((de + wn e / 4)^2 + 9/16 wn^2 e^2), wn = 20 rad/s."""
    _, rows = nominal
    rows = rows[rows["mode"] == Mode.TRACKING]
    e, de = rows["q_d"] - rows["q"], rows["dq_d"] - rows["dq"]
    V = (600.0 * ((de + 5.0 * e) ** 2 + 225.0 * e**2)).sum(axis=1)
    np.testing.assert_allclose(rows["lyapunov"], V, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(rows["lyapunov_rate"][1:], np.diff(V) / 1e-3, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize(("disturbance", "alarmed"), [(8.0, False), (6.0, True)])
def test_lyapunov_monitor_alarms_only_for_a_load_above_the_configured_disturbance(disturbance, alarmed):
    rows = run(watched("warn", disturbance, limits={"following_error_m": 0.1}), LOAD, until_s=2.45)
    assert bool(alarms(rows)) == alarmed
    assert not rows["faults"].any(), "the monitor only warns"
    assert np.sqrt(rows["lyapunov"].max(where=np.isfinite(rows["lyapunov"]), initial=0.0)) > 8.0


def test_law_with_delay_compensation_raises_no_lyapunov_alarm_under_the_configured_disturbance():
    """The law does not predict the load: 7.7 m/s^2 on a leg act like 10.2."""
    rows = run(watched("warn", controller=AHEAD), LOAD, until_s=2.4)
    assert alarms(rows) == 0
    assert rows["lyapunov_share"][-100:].max() > 0.9


@pytest.mark.parametrize(("name", "until_s"), broad([("lab", 2.1), ("vcan50", 3.5), ("ideal", 1.3)], quick=2))
def test_other_shipped_configurations_raise_no_lyapunov_alarm(name, until_s):
    rows = run(watched("warn", name=name), until_s=until_s)
    assert np.isfinite(rows["lyapunov_share"]).sum() > 0.3 * len(rows)
    assert alarms(rows) == 0
