"""A tracker by UDP in whole runs: in lockstep and over loopback, both replayed exactly."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from drivers.signals import Mode
from hil.app.configuration.configuration import load
from hil.app.run.command import run_daemon
from hil.app.sim.command import simulate
from hil.record.log import Log
from tests.drivers.test_mocap import free_port
from tests.loop.bench import changed
from tests.loop.test_sensor_families import SHORT


def tracked(**plant: Any) -> Any:
    """`desktop` with a tracker by UDP at 100 Hz, whose datagrams take 3 ms and up to 4 ms more."""
    channel = f"127.0.0.1:{free_port()}"
    bus = {
        "channels": [
            {"channel": "desktop0", "legs": [*range(6)]},
            {"channel": channel, "interface": "udp", "options": {"source": "127.0.0.1"}},
        ]
    }
    tracker = {
        "rate_Hz": 100, "channel": channel, "position_std_m": 1e-4, "orientation_std_deg": 0.05,
        "device": {"protocol": "mocap", "latency_ms": 3},
    }  # fmt: skip
    noise = {"position_noise_m": 2e-5, "orientation_noise_deg": 0.002, "latency_ms": 3, "jitter_ms": 4}
    return changed(
        "desktop",
        **SHORT,
        bus=bus,
        sensors={"tracker": tracker},
        plant={"sensors": {"tracker": noise | plant}},
    )


def assert_tracked(summary: Any, within_m: float) -> None:
    """The run succeeded, replays exactly, and the samples are the pose of the legs at their instants."""
    assert summary["success"], summary["trouble"]
    assert summary["replay"]["exact"]
    rows = Log.open(summary["log"]).rows()
    rows = rows[rows["mode"] == Mode.TRACKING][200:]
    t = rows["t_ns"] * 1e-9
    then = t - rows["tracker_age"]
    assert then.min() > t[0] - 0.05
    for k in range(3):
        off = rows["tracker_pose"][:, k] - np.interp(then, t, rows["p"][:, k])
        assert np.abs(off[then > t[0]]).max() < within_m
    assert rows["rejected"].sum() == 0


def test_simulated_run_with_a_tracker_by_udp_replays_exactly(tmp_path):
    c = tracked(lost_percent=10)
    summary = simulate(c, duration_s=3.0, log=tmp_path / "run.mcap")
    assert_tracked(summary, 2e-4)
    by_channel = summary["bus_load_percent_by_channel"]
    assert [load for name, load in by_channel.items() if "127" in name] == [0.0]
    assert summary["bus_load_percent"] < 70


@pytest.mark.realtime
def test_run_with_a_plant_sends_the_tracker_over_loopback_and_replays_exactly(tmp_path):
    (tmp_path / "tracked.yaml").write_text(tracked().text)  # the plant's process reads the file
    c = load(str(tmp_path / "tracked.yaml"))
    log = tmp_path / "run.mcap"
    summary = run_daemon(c, duration_s=3.0, log=log, with_plant=True, draw=False, arm=True)
    assert_tracked(summary, 1e-3)
