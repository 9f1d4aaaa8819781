"""The certificate watched in the loop: a drive that pulls instead of pushing, and nothing else, alarms.

The book's platform, path and bus. Tracking begins at 0.95 s; the far point of the path is one second on.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from drivers.can.bus_time import BitTiming
from drivers.signals import Fault, Mode, Warn
from drivers.tick_columns import ROW
from hil.app.compose import build_cycle, build_nodes
from hil.app.configuration.bus_budget import bus_budget
from hil.app.configuration.configuration import load, loads
from hil.app.sim.command import simulate
from hil.app.sim.lockstep import Lockstep
from hil.record.log import Log
from hil.signals import Operator
from plant_fmu.faults.kinds import DriveSign, WrenchStep
from plant_fmu.faults.plan import FaultPlan
from tests.broad import broad

SLIDING = """controller:
  law: sliding_mode
  lambda_rad_s: 92
  reaching_m_s2: 1
  uncertainty: {disturbance_m_s2: 13, model_error: 0.1, acceleration_m_s2: 12}
"""
POSE = """controller:
  law: pose_inverse_dynamics
  wn_rad_s: 20
"""
AHEAD = """controller:
  law: inverse_dynamics
  wn_rad_s: 90
  delay_compensation: {bus_ms: 0.5, drive_lag_ms: 0.8, hold_ms: 0.5}
"""
LOAD = WrenchStep(at_s=2.2, force_N=(-1.12e3, -6.46e3, 7.55e3), moment_N_m=(0.0, 0.0, 0.0))
"""10 kN where they move leg 1 most: J M^-1 wrench is 7.7 m/s^2."""


def bench(action, disturbance=8.0, name="virtual", controller=None, **changes):
    text = load(name).text
    if controller is not None:
        text = text[: text.index("\ncontroller:") + 1] + controller + text[text.index("\nmonitor:") :]
    monitor = f"\nmonitor: {{action: {action}, disturbance_m_s2: {disturbance}}}\n"
    if "\nmonitor:" in text:
        text = text[: text.index("\nmonitor:")] + text[text.index("\nengage:") :]
    text = text.replace("\nengage:", monitor + "engage:", 1)
    for key, value in changes.items():
        (line,) = [line for line in text.splitlines() if line.startswith(f"  {key}: ")]
        text = text.replace(line, f"  {key}: {value}")
    return loads(text, "monitor.yaml", Path())


def run(c, faults, until_s):
    """Return the rows up to an instant, or to a fault."""
    cycle = build_cycle(c, c.loop.rate_Hz, 1e-3 * c.drives.watchdog_ms)
    nodes, plant = build_nodes(c, FaultPlan(faults))
    rate = c.loop.rate_Hz
    timing = None if bus_budget(c.bus, c.drives, c.sensors, rate) is None else BitTiming.of(c.bus)
    lockstep = Lockstep(cycle, nodes, (timing,), c.loop.window_s(rate))
    rows, engaged = [], False
    operator: tuple[Operator, ...] = ()
    try:
        for _ in range(round(until_s * rate)):
            _, _, out = lockstep.step(operator)
            rows.append(out.row.copy())
            operator = (Operator.ENGAGE,) if cycle.mode is Mode.IDLE and not engaged else ()
            engaged = engaged or bool(operator)
            if cycle.faults:
                break
    finally:
        plant.close()
    return np.array(rows, ROW)


def alarms(rows):
    return int(np.count_nonzero(rows["warnings"] & Warn.CERTIFICATE))


# (instant, legs): the legs that then carry 1 kN or more; a leg carries 1.03 to 16.0 kN
FLIPS = [(1.05, (3,)), (1.25, (1,)), (1.5, (2,)), (1.75, (0,)), (2.25, (4, 5))]


@pytest.mark.parametrize(("start_s", "leg"), [(t, leg) for t, legs in FLIPS for leg in legs])
def test_a_flipped_gain_ends_the_run_within_20_ms_while_the_leg_carries_force(start_s, leg):
    rows = run(bench("fault"), [DriveSign(leg=leg, at_s=start_s)], start_s + 0.05)
    before = rows[np.searchsorted(rows["t_ns"], 1e9 * start_s) - 1]
    assert abs(before["tau"][leg]) > 1000.0
    assert not before["warnings"]
    assert rows["faults"][-1] == Fault.CERTIFICATE, "before any other rule notices"
    assert 0.0 < 1e-9 * rows["t_ns"][-1] - start_s <= 0.020


@pytest.mark.parametrize("controller", [SLIDING, POSE], ids=["sliding mode", "pose"])
def test_it_does_so_under_other_certified_laws(controller):
    rows = run(bench("fault", controller=controller), [DriveSign(leg=5, at_s=1.75)], 1.8)
    assert rows["faults"][-1] == Fault.CERTIFICATE
    assert 1e-9 * rows["t_ns"][-1] - 1.75 <= 0.020


@pytest.fixture(scope="module")
def nominal(tmp_path_factory):
    """From rest over path, stop and brakes to rest."""
    path = tmp_path_factory.mktemp("monitor") / "nominal.mcap"
    summary = simulate(bench("fault", periods=1), log=path, duration_s=2.6, check_replay=True)
    return summary, Log.open(path).rows()


def test_the_nominal_run_stays_far_from_its_bound_and_replays_to_the_bit(nominal):
    summary, rows = nominal
    assert summary["success"], summary
    assert summary["replay"]["different_ticks"] == 0
    assert summary["certificate"]["alarms"] == alarms(rows) == 0
    assert summary["certificate"]["largest_share_percent"] < 60.0
    assert Mode.STOPPING in rows["mode"]


def test_every_tick_with_open_brakes_is_watched(nominal):
    _, rows = nominal
    driving = (rows["mode"] >= Mode.APPROACH) & (rows["mode"] <= Mode.STOPPING)
    for column in ("lyapunov", "lyapunov_rate", "lyapunov_bound", "lyapunov_share"):
        assert np.isfinite(rows[column][driving]).all(), column
        assert np.isnan(rows[column][rows["mode"] < Mode.RELEASING]).all(), column
        assert np.isnan(rows[column][rows["mode"] > Mode.STOPPING]).all(), column


def test_V_is_that_of_the_smallest_reachable_ellipsoid_and_its_rate_a_difference(nominal):
    """At critical damping V = 3/2 wn^2 ((de + wn e / 4)^2 + 9/16 wn^2 e^2), wn = 20 rad/s."""
    _, rows = nominal
    rows = rows[rows["mode"] == Mode.TRACKING]
    e, de = rows["q_d"] - rows["q"], rows["dq_d"] - rows["dq"]
    V = (600.0 * ((de + 5.0 * e) ** 2 + 225.0 * e**2)).sum(axis=1)
    np.testing.assert_allclose(rows["lyapunov"], V, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(rows["lyapunov_rate"][1:], np.diff(V) / 1e-3, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize(("disturbance", "alarmed"), [(8.0, False), (6.0, True)])
def test_an_untold_load_alarms_where_it_is_more_than_what_is_stated(disturbance, alarmed):
    rows = run(bench("warn", disturbance, following_error_m=0.1), [LOAD], 2.45)
    assert bool(alarms(rows)) == alarmed
    assert not rows["faults"].any(), "it only warns"
    assert np.sqrt(rows["lyapunov"].max(where=np.isfinite(rows["lyapunov"]), initial=0.0)) > 8.0


def test_nor_does_it_alarm_a_law_that_looks_ahead():
    """It does not see the load coming: 7.7 m/s^2 on a leg act like 10.2."""
    rows = run(bench("warn", controller=AHEAD), [LOAD], 2.4)
    assert alarms(rows) == 0
    assert rows["lyapunov_share"][-100:].max() > 0.9


@pytest.mark.parametrize(("name", "until_s"), broad([("lab", 2.1), ("vcan50", 3.5), ("ideal", 1.3)], quick=2))
def test_other_shipped_configurations_do_not_alarm(name, until_s):
    rows = run(bench("warn", name=name), [], until_s)
    assert np.isfinite(rows["lyapunov_share"]).sum() > 0.3 * len(rows)
    assert alarms(rows) == 0


def test_without_a_certificate_nothing_is_watched():
    pd = "controller:\n  law: pd\n  kp_N_m: 2.0e+6\n  kv_N_s_m: 5.0e+4\n"
    rows = run(bench("log", controller=pd), [], 1.0)
    assert (rows["mode"] == Mode.APPROACH).any()
    assert np.isnan(rows["lyapunov"]).all()
