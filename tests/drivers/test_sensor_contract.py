"""Contract suite of the sensor families; their bytes: test_sensor_vectors.py."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from drivers.frame_array import joined
from hil.contracts.sensor import SensorContract

ROOT, EXAMPLES = Path(__file__).parents[2], "docs/examples/sensors"
MATRIX = (1e3 * (np.eye(6) + 0.1 * np.arange(36).reshape(6, 6) / 36)).tolist()


class TestStampedTracker(SensorContract):
    ROLE = "tracker"
    SETTINGS = {"rate_Hz": 250}
    RESOLUTION = 2e-6


class TestStampedImu(SensorContract):
    ROLE = "imu"
    SETTINGS = {"rate_Hz": 500}
    RESOLUTION = 2e-3


def device(rate_Hz: float, protocol: str, **keys: Any) -> dict[str, Any]:
    return {"rate_Hz": rate_Hz, "device": {"protocol": protocol, "latency_ms": 2, **keys}}


class TestCia406Sync(SensorContract):
    ROLE = "lengths"
    SETTINGS = {"rate_Hz": 1000, "device": {"protocol": "cia406", "step_m": -1e-6, "zero_m": 2.0}}
    RESOLUTION = 0.6e-6


class TestCia406Cyclic(SensorContract):
    ROLE = "lengths"
    SETTINGS = device(500, "cia406", step_m=1e-6, trigger="cyclic")
    RESOLUTION = 0.6e-6


class TestCia406Change(SensorContract):
    ROLE = "lengths"
    SETTINGS = device(500, "cia406", step_m=1e-5, trigger="change", format="int32")
    RESOLUTION = 6e-6


class TestCia404(SensorContract):
    ROLE = "forces"
    SETTINGS = device(250, "cia404", trigger="cyclic", format="int16", scale_N=0.5)
    RESOLUTION = 0.26


class TestAti(SensorContract):
    ROLE = "wrench"
    SETTINGS = {"rate_Hz": 1000, "device": {"protocol": "ati", "matrix": MATRIX, "calibration": 2}}
    RESOLUTION = 1e-2


class TestXsensByDbc(SensorContract):
    ROLE = "imu"
    SIGNALS = {"wx": "gyrX", "wy": "gyrY", "wz": "gyrZ", "fx": "accX", "fy": "accY", "fz": "accZ"}
    SETTINGS = device(500, "dbc", file=f"{EXAMPLES}/xsens_mti.dbc", signals=SIGNALS)
    RESOLUTION = 3e-3
    FOLDER = ROOT


class TestJ1939ByDbc(SensorContract):
    ROLE = "inclination"
    SIGNALS = {"roll": "Roll", "pitch": "Pitch"}
    SETTINGS = device(
        100,
        "dbc",
        file=f"{EXAMPLES}/j1939_imu.dbc",
        signals=SIGNALS,
        valid={"PitchMerit": 0},
        start=["000#0180"],
    )
    RESOLUTION = 1e-6
    FOLDER = ROOT


class TestLegsOfOneMessageByDbc(SensorContract):
    ROLE = "lengths"
    SIGNALS = {f"leg_{leg}": f"L{leg}" for leg in range(6)}
    VALID = {"LEGS_STATUS.Fault": 0}
    SETTINGS = device(250, "dbc", file="tests/data/sensor_messages.dbc", signals=SIGNALS, valid=VALID)
    RESOLUTION = 3e-5
    FOLDER = ROOT

    def test_emulated_sensor_with_one_message_for_several_legs_sends_them_in_one_frame(self, protocol):
        _, frames, _ = self.run(protocol, 100, lost_percent=30)
        ours = joined(frames)
        assert set(ours["id"].tolist()) == {700, 701, 702}
        for frame in ours[ours["id"] == 700]:
            raw = np.frombuffer(frame["data"].tobytes()[:8], "<u2")
            assert raw.byteswap()[2] > 19_000, "the third leg is big endian"
            assert (raw[[0, 1, 3]] > 19_000).all(), "1 m and more, at 0.05 mm a step"
        assert len(protocol.cyclic_frames(1000)) == 3
