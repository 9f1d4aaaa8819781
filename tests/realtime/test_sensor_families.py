"""Drives of several families with second encoders, load cells and a tracker on a second bus, in real time."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from drivers.signals import Mode
from hil.app.configuration.configuration import Configuration, load
from hil.app.replay import replay_log
from hil.record.log import Log
from tests.loop.bench import changed
from tests.loop.test_sensor_families import on_a_bus_of_their_own
from tests.realtime.rig import CHANNEL, START_S, Process

pytestmark = [pytest.mark.realtime, pytest.mark.long]


def driven(family: str) -> Configuration:
    """Drives of a family with their sensors; of `vesc`, which sends by a timer, without any."""
    if family == "vesc":
        return load("docs/examples/drives/vesc.yaml")
    return on_a_bus_of_their_own(family)


@pytest.mark.parametrize("family", ["mit, damiao DM4310", "moteus", "odrive", "cia402, difference", "vesc"])
def test_drives_of_each_family_run_in_real_time_with_the_sensors_of_a_second_bus(
    family: str, tmp_path: Path, start: Callable[..., Process]
) -> None:
    c = driven(family)
    names = [each.channel for each in c.bus.buses]
    c = changed(c, loop={"without_realtime": "slow"}, limits={"stretch_percent": 100})
    text = c.text
    for name in names:
        text = text.replace(f"channel: {name}", f"channel: {CHANNEL}-{name}")
    file = tmp_path / "my.yaml"
    file.write_text(text)
    (tmp_path / "vesc.dbc").write_text(Path("docs/examples/drives/vesc.dbc").read_text())
    log = tmp_path / "run.mcap"
    process = start("run", str(file), "--plant", "--duration", "3", "--log", str(log))
    process.wait(START_S)
    assert process.summary["success"], (process.summary["trouble"], process.errors)
    assert replay_log(log)[0].exact
    rows = Log(log).rows()
    rows = rows[rows["mode"] == Mode.TRACKING]
    assert np.abs(rows["q"] - rows["q_d"]).max() < 0.01
    if c.sensors.lengths is not None:
        period_s = 1.0 / process.summary["rate_Hz"]
        assert np.median(rows["length_sensor_age"]) <= period_s * (1.0 + 1e-9)
        assert np.abs(rows["length_sensor"] - rows["q"]).max() < 2e-3
        assert np.median(rows["tracker_age"]) < 16e-3
        assert np.isfinite(rows["force_sensor"]).all()
