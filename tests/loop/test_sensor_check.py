"""Sensors next to the drives, compared with the legs: agreement, and the warning where they differ or are silent."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.arrays import Rows
from drivers.signals import Mode, Warn
from drivers.tick_columns import SENSORS
from hil.app.configuration.configuration import Configuration
from plant_fmu.faults import kinds
from plant_fmu.faults.fault import Fault as PlantFault
from tests.loop.bench import changed, run
from tests.loop.fusion_runs import SOON

EXAMPLES = Path(__file__).parents[2] / "docs/examples/sensors"
INCLINATION: dict[str, Any] = {
    "rate_Hz": 100,
    "device": {
        "protocol": "dbc",
        "file": str(EXAMPLES / "cia410.dbc"),
        "signals": {"roll": "SlopeLong", "pitch": "SlopeLateral"},
        "latency_ms": 5,
    },
}
CELLS: dict[str, Any] = {
    "rate_Hz": 100,
    "channel": "cells0",
    "std_N": 20,
    "node_ids": [*range(21, 27)],
    "device": {"protocol": "cia404", "format": "float32"},
}
NOISE: dict[str, Any] = {"tracker": {"latency_ms": 5}, "inclination": {"latency_ms": 5}}
AT: dict[str, Any] = {"at_s": 0.4, "mode": "TRACKING"}


OURS = ("tracker", "imu", "inclination", *(f"force_{leg}" for leg in range(6)))


def bench(**noise: Any) -> Configuration:
    """`virtual` with a tracker, an IMU, an inclinometer and load cells that nothing fuses."""
    sensors = {"tracker": {"rate_Hz": 200}, "imu": {"rate_Hz": 200}, "inclination": INCLINATION}
    sensors["forces"] = CELLS
    plant = SOON["plant"] | {"sensors": NOISE | noise}
    buses = [{"channel": "hil0", "legs": [*range(6)]}, {"channel": "cells0", "layout": "classic"}]
    bus = {"max_load_percent": 90, "channels": buses}
    return changed("virtual", **SOON | {"sensors": sensors, "plant": plant, "bus": bus})


def ticks(c: Configuration, *faults: PlantFault) -> tuple[Rows, Mode]:
    rows: list[Any] = []
    ran = run(c, *faults, watch=lambda _lockstep, _inp, row: rows.append(row.copy()))
    return np.array(rows, rows[0].dtype), ran.ending.mode


def warned(rows: Rows) -> Rows:
    """Ticks with the warning SENSOR."""
    found: Rows = rows[(rows["warnings"] & Warn.SENSOR) != 0]
    return found


def share(rows: Rows, sensor: str) -> Any:
    return rows["sensor_share"][:, SENSORS.index(sensor)]


def test_good_sensors_differ_from_the_legs_by_a_fraction_of_the_alarm_limits_in_motion():
    rows, mode = ticks(bench())
    assert mode is Mode.PARKED
    moving = rows[rows["mode"] == Mode.TRACKING]
    assert np.abs(moving["twist"]).max() > 0.5
    for sensor in OURS:
        assert 0.0 < np.nanmax(share(moving, sensor)) < 0.7, sensor
    assert np.isnan(share(rows, "wrench")).all()
    assert not len(warned(rows))


@pytest.mark.parametrize(
    ("sensor", "fault", "within_s"),
    [
        ("tracker", kinds.SensorOffset(sensor="tracker", axis=1, by=8e-3, **AT), 0.3),
        ("tracker", kinds.SensorOffset(sensor="tracker", axis=5, by=0.02, **AT), 0.3),
        ("imu", kinds.SensorOffset(sensor="imu", axis=2, by=0.5, **AT), 0.3),
        ("inclination", kinds.SensorOffset(sensor="inclination", axis=0, by=0.02, **AT), 0.4),
        ("inclination", kinds.SensorOffset(sensor="inclination", axis=1, by=-0.02, **AT), 0.4),
        ("force_2", kinds.SensorOffset(sensor="force_2", axis=0, by=400.0, **AT), 0.3),
        ("force_2", kinds.SensorLost(sensor="force_2", **AT), 0.1),
        ("tracker", kinds.SensorFrozen(sensor="tracker", **AT), 0.5),
        ("tracker", kinds.SensorLost(sensor="tracker", **AT), 0.05),
        ("inclination", kinds.SensorLost(sensor="inclination", **AT), 0.1),
    ],
)
def test_sensor_that_contradicts_the_leg_lengths_or_is_silent_causes_a_warning(sensor, fault, within_s):
    rows, mode = ticks(bench(), fault)
    assert mode is Mode.PARKED, "a warning does not end the run"
    first = warned(rows)[0]
    begin = rows["tick"][np.argmax(rows["mode"] == Mode.TRACKING)] + 400
    assert 0 <= first["tick"] - begin <= 1e3 * within_s
    others = [each for each in OURS if each != sensor]
    assert first["sensor_share"][SENSORS.index(sensor)] > 1.0
    assert not any((share(rows, each) > 1.0).any() for each in others)
