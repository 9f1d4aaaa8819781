"""Processes killed by SIGKILL during motion. Each test starts on what the one before left behind."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from drivers.signals import LEGS, DriveFault, DriveMode, DriveState, Fault
from hil.app.compose import build_protocol
from hil.app.configuration.configuration import load
from hil.app.replay import replay_log
from hil.contracts.messages import DeviceCommand
from hil.record.log import Log
from hil.record.salvage import salvage
from tests.drivers.legs_frames import parse
from tests.realtime.rig import FIFO, ROOT, Listener, Process, configuration, wait_until_gone

pytestmark = pytest.mark.realtime

FAST_m_s = 0.7
FULL_RATE = {"without_realtime: slow ": "without_realtime: refuse "}
"""The rate is not reduced."""
STROKE_m = (0.75, 2.2)
"""length_min_m and length_max_m of configs/virtual.yaml."""

Start = Callable[..., Process]
Listen = Callable[[Path], Listener]


def logs(folder: Path) -> tuple[Path, Path]:
    """Logs of the daemon and of the plant, of the last run."""
    plant = max((folder / "runs").glob("*-plant.mcap"), key=lambda file: file.stat().st_ctime_ns)
    return plant.with_name(plant.name.replace("-plant", "")), plant


def impatient(start: Start, listen: Listen, file: Path) -> Process:
    """A run in motion, without the checks for real time."""
    run = start("run", str(file), "--plant", entry="tests.realtime.assumed_realtime")
    listen(file).wait_for_motion(run, FAST_m_s)
    return run


def last_command(file: Path, log: Log) -> tuple[int, int]:
    """Time and mode of the last command that the drives received."""
    protocol = build_protocol(load(str(file)))
    found = (0, -1)
    for tick in log.ticks():
        for t_ns, frame in tick.received:
            message = parse(protocol, frame)
            if isinstance(message, DeviceCommand):
                found = (t_ns, message.mode)
    return found


def test_platform_is_at_rest_and_the_log_complete_after_the_controller_process_is_killed(
    tmp_path: Path, start: Start, listen: Listen
) -> None:
    file = configuration(tmp_path, {"watchdog_ms: 150 ": "watchdog_ms: 10 ", **FULL_RATE})
    run = impatient(start, listen, file)
    family = run.find_family()

    os.kill(run.pid, signal.SIGKILL)

    run.wait()
    wait_until_gone(*family.values())
    daemon_log, plant_log = logs(tmp_path)
    log, plant = Log.open(daemon_log), Log.open(plant_log)
    watchdog_s = float(log.metadata["hil"]["watchdog_s"])
    rows = plant.rows()

    heard_ns, mode = last_command(file, plant)
    assert mode == DriveMode.RUN, "killed in mid-motion"
    reacted = rows[(rows["drive_state"] == DriveState.FAULT).all(axis=1)]
    assert (reacted["drive_fault"] == DriveFault.WATCHDOG).all()
    assert watchdog_s * 1e9 <= int(reacted["t_ns"][0]) - heard_ns + 100_000
    assert int(reacted["t_ns"][0]) - heard_ns <= (watchdog_s + 0.010) * 1e9
    if FIFO:
        assert int(reacted["t_ns"][0]) - heard_ns <= 20_000_000
    assert np.abs(reacted["rate"][0]).max() > FAST_m_s / 2, "still moving when the drives reacted"

    assert rows["length"].min() > STROKE_m[0]
    assert rows["length"].max() < STROKE_m[1]
    assert np.abs(rows["rate"][-1]).max() < 1e-3
    assert (rows["brake"][-1] == 1).all()
    assert plant.summary.closed == "clean"
    assert plant.metadata["summary"]["ending"] == "orphaned"

    ticks = log.rows()
    assert log.summary.closed == "producer died"
    assert log.summary.dropped == 0
    syncs, commands = int(rows["syncs"][-1]), int(rows["commands"][-1])
    assert commands - 1 <= len(ticks) <= commands <= syncs <= len(ticks) + 1, "nothing lost"
    assert replay_log(daemon_log)[0].exact


@pytest.mark.long
@pytest.mark.realtime(patient=True)
@pytest.mark.parametrize("on_loss", ["continue", "stop"])
def test_platform_parks_safely_if_the_recorder_process_is_killed(
    tmp_path: Path, start: Start, listen: Listen, on_loss: str
) -> None:
    changes = {"on_recorder_loss: continue": f"on_recorder_loss: {on_loss}"}
    file = configuration(tmp_path, changes, short=on_loss == "continue")
    run = start("run", str(file), "--plant")
    listen(file).wait_for_motion(run, 0.2)
    family = run.find_family()

    os.kill(family["recorder"], signal.SIGKILL)

    code = run.wait()
    summary = run.summary
    salvaged = salvage(logs(tmp_path)[0], tmp_path / "salvaged.mcap")
    total = summary["plant"]["syncs"]
    assert salvaged.ticks > 0
    assert total - salvaged.ticks <= summary["dropped_ticks"] < total
    assert "the recorder died" in summary["recorder"]
    assert "--salvage" in summary["recorder"]
    assert "recorder" in run.errors
    assert "Traceback" not in run.errors
    assert summary["plant"]["final_states"] == ["OFF"] * LEGS
    assert summary["plant"]["peak_final_rate_m_s"] < 1e-3
    if on_loss == "continue":
        assert (code, summary["success"], summary["ending"]) == (0, True, "parked")
    else:
        assert (code, summary["success"], summary["ending"]) == (1, False, "parked")
        assert "controlled stop" in summary["trouble"]
        assert "recorder" in summary["trouble"]
    assert replay_log(tmp_path / "salvaged.mcap")[0].exact


@pytest.mark.long
def test_log_loses_at_most_a_quarter_second_if_all_processes_are_killed(
    tmp_path: Path, start: Start, listen: Listen
) -> None:
    file = configuration(tmp_path)
    run = start("run", str(file), "--plant")
    listener = listen(file)
    listener.wait_for_motion(run, FAST_m_s)
    family = run.find_family()

    for pid in family.values():
        os.kill(pid, signal.SIGKILL)

    wait_until_gone(*family.values())
    listener.look()
    daemon_log, plant_log = logs(tmp_path)
    out, summary = tmp_path / "salvaged.mcap", tmp_path / "replay.json"
    command = [sys.executable, "-m", "hil.cli", "replay", "--salvage", str(out), str(daemon_log)]
    done = subprocess.run(
        [*command, "--json", str(summary)], cwd=ROOT, capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 0, done.stderr
    last_ns = int(Log.open(out).rows()["t_ns"][-1])
    assert listener.last_sync_ns - last_ns <= 250_000_000
    assert listener.last_sync_ns >= last_ns, "the listener received all logged frames"

    salvage(plant_log, tmp_path / "salvaged-plant.mcap")
    plant_rows = Log.open(tmp_path / "salvaged-plant.mcap").rows()
    assert listener.last_sync_ns - int(plant_rows["t_ns"][-1]) <= 250_000_000


@pytest.mark.long
def test_controller_faults_within_five_periods_if_the_plant_process_is_killed(
    tmp_path: Path, start: Start, listen: Listen
) -> None:
    file = configuration(tmp_path, {"stale_fault_ticks: 60": "stale_fault_ticks: 5"})
    run = start("run", str(file), "--plant")
    listener = listen(file)
    listener.wait_for_motion(run, FAST_m_s)
    family = run.find_family()
    killed_ns = listener.now()

    os.kill(family["plant"], signal.SIGKILL)

    assert run.wait() == 1
    wait_until_gone(*family.values())
    daemon_log, _ = logs(tmp_path)
    log = Log.open(daemon_log)
    rows = log.rows()
    fault = rows[np.argmax(rows["faults"] != 0)]
    heard = rows[(rows["age"] == 0).all(axis=1)][-1]
    assert fault["faults"] & Fault.STALE
    period_ns = round(1e9 / float(log.metadata["hil"]["rate_Hz"]))
    between = rows[(rows["tick"] > heard["tick"]) & (rows["tick"] <= fault["tick"])]
    allowed_ns = (5 + int(between["skipped"].sum())) * period_ns
    assert int(fault["t_ns"] - heard["t_ns"]) <= allowed_ns
    if FIFO:
        # five periods of 2 ms; a machine that does not keep SCHED_FIFO has longer ones
        assert int(fault["t_ns"]) - killed_ns <= allowed_ns

    protocol = build_protocol(load(str(file)))
    after = [tick for tick in log.ticks() if tick.row["tick"] > fault["tick"]]
    modes = [
        message.mode
        for tick in after
        for message in (parse(protocol, frame) for frame in tick.sent)
        if isinstance(message, DeviceCommand)
    ]
    assert list(dict.fromkeys(modes)) == [DriveMode.READY, DriveMode.OFF], "brakes first, then off"
    assert modes.count(DriveMode.OFF) >= 5
    assert modes.count(DriveMode.READY) <= round(1.1e9 / period_ns)

    summary = run.summary
    for text in (summary["trouble"], run.errors):
        assert "STALE" in text
        assert f"process {family['plant']}, was killed by SIGKILL" in text
    assert "Traceback" not in run.errors
    assert replay_log(daemon_log)[0].exact
