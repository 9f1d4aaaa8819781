"""`hil identify sensors` finds what the emulated devices hide, and the printed block takes it off the samples."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from drivers.sensing.layout import LENGTH, TRACKER
from drivers.signals import Mode
from hil.app.sim.command import simulate
from hil.lab.identify.sensors import file_text, identify_sensors, summary
from hil.record.log import Log
from tests.broad import broad
from tests.loop.bench import changed
from tests.loop.test_sensor_check import INCLINATION

LIMITS = {
    "time_offset_ms": 0.2, "frame_position_m": 1e-4, "frame_rotation_deg": 0.01, "lever_arm_m": 5e-4,
    "target_rotation_deg": 0.01, "angular_rate_bias_rad_s": 2e-4, "specific_force_bias_m_s2": 5e-3,
    "scale": 1e-4, "offset_m": 2e-5,
}  # fmt: skip
AXES = ("x_m", "y_m", "z_m", "rx_deg", "ry_deg", "rz_deg")
ROBOTS = {"virtual": (0.1, 8.0, "hil0"), "desktop": (0.02, 5.0, "desktop0")}
"""Amplitudes m and degrees; channel of the drives."""
ENCODER_MS = {"virtual": 0.0, "desktop": 0.06}
"""From the SYNC of the sensors to the first encoder of a tick: frames of 75 and 135 us at 1 Mbit/s."""


def hidden(seed):
    """Errors of the devices, drawn from a seed."""
    draw = np.random.default_rng(seed)

    def three(size):
        return draw.uniform(-size, size, 3).tolist()

    tracker = {
        "time_offset_ms": draw.uniform(0, 3), "position_bias_m": three(5e-3), "frame_rotation_deg": three(1.0),
        "lever_arm_m": three(0.1), "target_rotation_deg": three(2.0),
        "position_noise_m": 2e-4, "orientation_noise_deg": 0.03, "lost_percent": 2, "outlier_percent": 0.3,
    }  # fmt: skip
    imu = {
        "time_offset_ms": draw.uniform(0, 1), "frame_rotation_deg": three(1.0), "lever_arm_m": three(0.05),
        "angular_rate_bias_rad_s": three(0.01), "specific_force_bias_m_s2": three(0.1),
    }  # fmt: skip
    lengths = {"bias_m": draw.uniform(-1e-3, 1e-3, 6).tolist()}
    return {"seed": seed, "tracker": tracker, "imu": imu, "lengths": lengths}


def moving(robot, seed, *, tilt=True, seconds=30, **sensors):
    metres, degrees, drives = ROBOTS[robot]
    rates = (0.25, 0.35, 0.3, 0.9, 1.1, 0.8)
    components: list[dict[str, Any]] = [
        {"axis": axis, "amplitude": metres if k < 3 else degrees, "frequency_Hz": rates[k], "phase_rad": k}
        for k, axis in enumerate(AXES)
        if tilt or k < 3
    ]
    bus = {
        "max_load_percent": 90,
        "channels": [{"channel": drives, "legs": [*range(6)]}, {"channel": "sensors0", "layout": "fd"}],
    }
    encoders = {"protocol": "cia406", "step_m": 1e-6, "zero_m": 0.1}
    lengths = {"rate_Hz": 50, "device": encoders, "on_contradiction": "warn"}
    roles: dict[str, Any] = {"tracker": {"rate_Hz": 200}, "imu": {"rate_Hz": 400}, "lengths": lengths}
    roles = {
        role: of | {"channel": "sensors0"} | {"calibration": sensors.get(role, {})}
        for role, of in roles.items()
    }
    reference = {"type": "sinusoids", "duration_s": seconds, "ramp_s": 2, "components": components}
    return changed(
        robot, bus=bus, reference=reference, sensors=roles, plant={"sensors": hidden(seed), "log": False}
    )


@pytest.fixture(scope="module")
def calibrated(tmp_path_factory):
    @cache
    def found(robot, seed):
        log, quick = tmp_path_factory.mktemp(robot) / f"{seed}.mcap", (robot, seed) == ("virtual", 1)
        configuration = moving(robot, seed, seconds=10 if quick else 30)
        assert simulate(configuration, log=log, check_replay=False)["success"]
        return identify_sensors(log)

    return found


def errors(robot, seed, found):
    """(role, key, errors, standard errors) of all that the devices hide."""
    of, sensors = hidden(seed), summary(found)["sensors"]
    of["tracker"]["frame_position_m"] = of["tracker"]["position_bias_m"]
    of["lengths"] |= {"time_offset_ms": 0.0, "scale": [1.0] * 6, "offset_m": of["lengths"]["bias_m"]}
    for role in ("tracker", "imu", "lengths"):
        of[role]["time_offset_ms"] += ENCODER_MS[robot]
        for key in LIMITS:
            if key in sensors[role]:
                each = sensors[role][key]
                assert each["determined"], (role, key)
                yield role, key, np.atleast_1d(each["value"]) - of[role][key], np.atleast_1d(each["std"])


@pytest.mark.parametrize(("robot", "seed"), broad([(r, s) for r in ROBOTS for s in (1, 2, 3)], quick=1))
def test_one_log_shows_time_frame_and_lever_arm(calibrated, robot, seed):
    ratios: dict[str, list[float]] = {}
    for role, key, error, std in errors(robot, seed, calibrated(robot, seed)):
        assert np.abs(error).max() < LIMITS[key], (role, key, error)
        ratios.setdefault(role, []).extend(error / std)
    for role, of in ratios.items():
        assert 0.3 < np.sqrt(np.mean(np.square(of))) < 1.7, (role, "standard errors")


@pytest.mark.long
@pytest.mark.parametrize("robot", ROBOTS)
def test_block_takes_the_errors_off_the_samples(calibrated, robot, tmp_path):
    sensors = yaml.safe_load(file_text(calibrated(robot, 1)))["sensors"]
    block = {role: of["calibration"] for role, of in sensors.items()}
    log = tmp_path / "again.mcap"
    assert simulate(moving(robot, 1, seconds=8, **block), log=log, check_replay=True)["success"]
    rows = Log.open(log).rows()
    rows = rows[rows["mode"] == Mode.TRACKING]
    t = rows["t_ns"] * 1e-9
    then = t - rows["tracker_age"]
    for k in range(3):
        off = rows["tracker_pose"][:, k] - np.interp(then, t, rows["p"][:, k])
        assert abs(np.median(off)) < 5e-5
        assert np.median(np.abs(off)) < 2e-4, "noise of 0.2 mm is left"
    legs = np.array(
        [np.interp(then, t, x) for x in Rotation.from_matrix(rows["R"].reshape(-1, 3, 3)).as_rotvec().T]
    )
    assert np.abs(np.median(np.rad2deg(rows["tracker_pose"][:, 3:] - legs.T), axis=0)).max() < 0.01
    compared = rows["sensor_share"][500:, [TRACKER, *range(LENGTH, LENGTH + 6)]]
    assert (compared < 1.0).all(), "compared with the legs"
    for role, key, error, _ in errors(robot, 1, identify_sensors(log)):
        assert np.abs(error).max() < 2.0 * LIMITS[key], (role, key, error, "of a log with a calibration")


@pytest.mark.long
def test_inclinometer_and_load_cells_lose_their_offsets_as_well(tmp_path):
    log, bias = tmp_path / "log.mcap", [10.0, 20.0, 30.0, -10.0, -20.0, -30.0]
    place = {"channel": "sensors0"}
    cells = {"rate_Hz": 50, "device": {"protocol": "cia404", "format": "float32", "trigger": "cyclic"}}
    c = changed(
        moving("virtual", 1, seconds=10),
        sensors={
            "tracker": None,
            "imu": None,
            "lengths": None,
            "inclination": INCLINATION | place,
            "forces": cells | place,
        },
        plant={"sensors": {"inclination": {"latency_ms": 7, "bias_deg": 0.4}, "forces": {"bias_N": bias}}},
    )
    assert simulate(c, log=log, check_replay=False)["success"]
    found = summary(identify_sensors(log))["sensors"]
    assert found["inclination"]["offset_deg"]["value"] == pytest.approx([0.4, 0.4], abs=0.005)
    late_ms = found["inclination"]["time_offset_ms"]["value"]
    assert late_ms == pytest.approx(2.1, abs=0.2), "7 ms, 5 ms of them stated, and the time of a frame"
    assert found["forces"]["offset_N"]["value"] == pytest.approx(bias, abs=5.0)
    assert found["forces"]["scale"]["value"] == pytest.approx([1.0] * 6, abs=1e-3)


@pytest.mark.long
def test_motion_without_tilt_does_not_determine_the_lever_arm(tmp_path):
    log = tmp_path / "flat.mcap"
    assert simulate(moving("virtual", 1, tilt=False, seconds=5), log=log, check_replay=False)["success"]
    found = summary(identify_sensors(log))["sensors"]["tracker"]
    assert not found["lever_arm_m"]["determined"]
    assert found["time_offset_ms"]["determined"]
