"""Sensors of several families next to any drives: on a bus of their own, and beside them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.errors import ConfigurationError
from drivers.signals import Mode
from hil.app.configuration.configuration import Configuration
from hil.app.derive_encoder_limits import leg_errors
from hil.app.replay import replay_log
from hil.app.sim.command import simulate
from hil.record.log import Log
from tests.loop.bench import changed, run
from tests.loop.fusion_runs import SOON
from tools.drive_families import FAMILIES, merged

ENCODERS: dict[str, Any] = {"rate_Hz": 400, "device": {"protocol": "cia406", "step_m": 1e-6, "zero_m": 0.1}}
CELLS: dict[str, Any] = {
    "node_ids": [21, 22, 23, 24, 25, 26],
    "rate_Hz": 100,
    "device": {"protocol": "cia404", "trigger": "cyclic"},
}
TRACKER: dict[str, Any] = {"rate_Hz": 100}
OWN_BUS: dict[str, Any] = {
    "channels": [{"channel": "desktop0", "legs": [0, 1, 2, 3, 4, 5]}, {"channel": "sensors0", "layout": "fd"}]
}
EXACT: dict[str, Any] = {
    "tracker": {"position_noise_m": 0, "orientation_noise_deg": 0, "latency_ms": 3},
    "lengths": {"noise_m": 0, "latency_ms": 0.1},
    "forces": {"noise_N": 0, "latency_ms": 0.5},
}
SHORT = {"engage": {"force_ramp_s": 0.05, "brake_release_s": 0.1, "blend_s": 0.1}}


def on_a_bus_of_their_own(family: str) -> Configuration:
    """`desktop` with some drives; second encoders, load cells and a tracker on a second bus."""
    latency = {"device": CELLS["device"] | {"latency_ms": 0.6}}
    roles = {"lengths": ENCODERS, "forces": CELLS | latency, "tracker": TRACKER}
    sensors = {role: settings | {"channel": "sensors0"} for role, settings in roles.items()}
    changes = merged(
        FAMILIES[family], {"bus": OWN_BUS, "sensors": sensors, "plant": {"sensors": EXACT}}, SHORT
    )
    return changed("desktop", **changes)


@pytest.mark.parametrize("family", ["mit, damiao DM4310", "moteus", "odrive", "cia402, difference"])
def test_second_encoders_load_cells_and_tracker_work_with_every_drive_family(family, tmp_path):
    c = on_a_bus_of_their_own(family)
    summary = simulate(c, duration_s=1.0, log=tmp_path / "run.mcap")
    assert summary["success"], summary["trouble"]
    assert summary["replay"]["exact"]
    rows = Log(tmp_path / "run.mcap").rows()
    rows = rows[rows["mode"] == Mode.TRACKING]
    assert len(rows) > 100
    period_s = 1.0 / c.loop.rate_Hz
    ticks = rows["length_sensor_age"] / period_s
    assert set(ticks.ravel().round(9)) <= {0.0, 1.0}, "sampled at a SYNC, read in its tick or the next"
    then = np.arange(len(rows))[:, None] - ticks.round().astype(int)
    apart = np.abs(rows["length_sensor"] - np.take_along_axis(rows["q"], np.maximum(then, 0), 0))[1:]
    assert apart.max() < 2e-4, "drives and sensors sample at most 1 ms apart"
    assert -period_s < rows["force_sensor_age"].min() <= rows["force_sensor_age"].max() < 0.014
    assert np.abs(rows["force_sensor"]).max() > 1.0
    assert 3e-3 - period_s < rows["tracker_age"].min() <= rows["tracker_age"].max() < 16e-3
    assert np.abs(rows["tracker_pose"][:, :3] - rows["p"]).max() < 5e-3
    assert rows["rejected"].sum() == 0
    assert rows["drive_force"].any() == leg_errors(c).reports_force == (family != "odrive")


def test_age_of_a_free_running_encoder_is_right_within_its_waiting_time_on_the_bus():
    encoders = merged(ENCODERS, {"rate_Hz": 500, "device": {"trigger": "cyclic", "latency_ms": 2.1}})
    changes = {
        "sensors": {"lengths": encoders},
        "plant": {"sensors": {"lengths": {"noise_m": 0, "latency_ms": 2}}},
        "loop": {"rate_Hz": 312.5},
        "drives": {"watchdog_ms": 20},
        "bus": {"max_load_percent": 95},
    }
    rows = run(changed("desktop", **merged(FAMILIES["cia402, difference"], SHORT, changes))).tracking
    age_s, t_s = rows["length_sensor_age"][:, 0], rows["t_ns"] * 1e-9
    assert 2.0e-3 < age_s.min() <= age_s.max() < 2.1e-3 + 2 / 312.5
    assert np.ptp(age_s) > 1e-3, "two clocks"
    settled = t_s - age_s > t_s[0]
    q, dq = (np.interp(t_s - age_s, t_s, rows[name][:, 0])[settled] for name in ("q", "dq"))
    error = rows["length_sensor"][settled, 0] - q
    off_s = (error @ dq) / (dq @ dq)
    assert abs(off_s) < 0.3e-3, "one frame or two, of 0.135 ms"
    assert np.std(error - off_s * dq) < 2e-5


@pytest.mark.parametrize("latency_ms", [0.1, 0.7])
def test_age_of_a_second_encoder_that_answers_each_sync_includes_its_latency(latency_ms):
    changes = {
        "sensors": {"lengths": ENCODERS | {"rate_Hz": 1000, "channel": "sensors0"}},
        "plant": {"sensors": {"lengths": {"noise_m": 0, "latency_ms": latency_ms}}},
        "bus": OWN_BUS | {"channel": None},
        "reference": {"periods": 1},
    }
    rows = run(changed("virtual", **merged(SHORT, changes)), stop_s=1.0).tracking
    period_s = 1e-3
    age = (rows["length_sensor_age"][:, 0] / period_s).round(9)
    assert set(age) == ({0.0} if latency_ms < 0.2 else {1.0}), "all drives have answered after 0.5 ms"
    then = np.arange(len(rows))[1:] - age[1:].astype(int)
    error, dq = rows["length_sensor"][1:, 0] - rows["q"][then, 0], rows["dq"][then, 0]
    assert np.abs(dq).max() > 0.03
    assert abs(error @ dq) / (dq @ dq) < 5e-5, "s; the SYNCs of the two buses end 28 us apart"


def test_two_sensors_in_one_dbc_message_measure_the_platform_together():
    file = str(Path(__file__).parents[2] / "docs/examples/sensors/j1939_imu.dbc")
    signals = {"inclination": {"roll": "RollAngle", "pitch": "PitchAngle"}, "imu": {"wy": "PitchRate"}}
    noise = {"inclination": {"noise_deg": 0}, "imu": {"angular_rate_noise_rad_s": 0}}
    changes = {
        "bus": {"max_load_percent": 90},
        "sensors": {
            role: {
                "rate_Hz": 100,
                "device": {"protocol": "dbc", "file": file, "signals": names, "latency_ms": 2},
            }
            for role, names in signals.items()
        },
        "plant": {"sensors": {role: own | {"latency_ms": 2} for role, own in noise.items()}},
    }
    rows = run(changed("virtual", **merged(SHORT, changes)), stop_s=1.0).tracking
    R, t = rows["R"].reshape(-1, 3, 3), np.arange(len(rows)) * 1e-3
    rate = np.einsum("nji,nj->ni", R, rows["twist"][:, 3:])[:, 1]
    for role, column, expected, step in (
        ("inclination", 1, -np.arcsin(R[:, 2, 0]), np.deg2rad(0.002)),
        ("imu", 1, rate, np.deg2rad(0.002)),
    ):
        error = rows[role][:, column] - np.interp(t - rows[f"{role}_age"], t, expected)
        assert np.abs(expected).max() > 0.02, "it moves"
        assert np.abs(error[20:]).max() < 5 * step
    assert rows["rejected"].sum() == 0


def test_replay_reads_the_dbc_of_a_sensor_from_the_log_alone(tmp_path):
    text = (Path(__file__).parents[2] / "docs/examples/sensors/cia410.dbc").read_text()
    (tmp_path / "my.dbc").write_text(text)
    signals = {"roll": "SlopeLong", "pitch": "SlopeLateral"}
    device = {"protocol": "dbc", "file": str(tmp_path / "my.dbc"), "signals": signals, "latency_ms": 2}
    changes = {
        "sensors": {"inclination": {"device": device}},
        "plant": {"sensors": {"inclination": {"latency_ms": 2}}},
    }
    log = tmp_path / "run.mcap"
    simulate(changed("virtual", **merged(SOON, changes)), duration_s=0.3, log=log)
    rows = Log(log).rows()
    R = rows["R"][-1]
    angles = np.arctan2(R[2, 1], R[2, 2]), -np.arcsin(R[2, 0])
    assert rows["inclination"][-1] == pytest.approx(angles, abs=1e-3), "at rest, in steps of 0.01 deg"
    (tmp_path / "my.dbc").unlink()
    comparison, _ = replay_log(log)
    assert comparison.exact


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"sensors": {"tracker": {}}}, ("sensors.tracker", "CAN FD", "layout classic", "bus of layout fd", "dbc")),
        ({"sensors": {"lengths": ENCODERS}}, ("without the sensors", "would fit", "bus of their own")),
        ({"sensors": {"lengths": merged(ENCODERS, {"node_ids": [1, 12, 13, 14, 15, 16]})}}, ("sensors.lengths.node_ids", "drives.node_ids")),
        ({"bus": {"channels": OWN_BUS["channels"]}}, ("bus.channels[1]", "legs or a sensor")),
    ],
)  # fmt: skip
def test_unsuitable_sensor_settings_are_refused_with_the_allowed_ones(changes, words):
    with pytest.raises(ConfigurationError) as raised:
        changed("desktop", **merged(FAMILIES["cia402, difference"], changes))
    assert all(word in str(raised.value) for word in words), str(raised.value)
