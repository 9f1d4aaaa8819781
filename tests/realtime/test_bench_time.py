"""A virtual bench on a machine that stalls one process: bench time pauses, and the run stays good."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.can.bus_time import BitTiming
from drivers.can.localcan.participant import Participant
from drivers.signals import Fault
from hil.record.log import Log
from tests.realtime.rig import CHANNEL, LASTING, Listener, Process, configuration

pytestmark = pytest.mark.realtime(patient=True)
STOPS_S = (0.008, 0.020, 0.060)
FAST_m_s = 0.4

Start = Callable[..., Process]
Listen = Callable[[Path], Listener]


def moving(start: Start, listen: Listen, file: Path) -> Process:
    """A run in motion."""
    run = start("run", str(file), "--plant")
    listen(file).wait_for_motion(run, FAST_m_s)
    return run


def whole(run: Process) -> dict[str, Any]:
    """Stop a run and return its summary; it must have run without errors at the configured rate."""
    run.interrupt()
    assert run.wait() == 0, run.errors
    summary = run.summary
    assert (summary["ending"], summary["rate_Hz"]) == ("parked on request", 1000)
    assert summary["skipped_ticks"] == 0
    assert summary["tracking"]["peak_leg_error_mm"] <= 0.5
    assert summary["replay"]["exact"]
    return summary


@pytest.mark.long
def test_simulated_time_pauses_while_the_controller_or_plant_process_is_stopped(
    tmp_path: Path, start: Start, listen: Listen
) -> None:
    run = moving(start, listen, configuration(tmp_path, LASTING, patient=False))
    family = run.find_family()
    for stop_s in STOPS_S:
        for side in ("daemon", "plant"):
            os.kill(family[side], signal.SIGSTOP)
            time.sleep(stop_s)
            os.kill(family[side], signal.SIGCONT)
            time.sleep(0.1)

    bench_time = whole(run)["bench_time"]
    assert bench_time["longest_ms"] >= 45
    assert bench_time["stretches"] >= 6
    assert bench_time["stood_still_ms"] >= 0.7e3 * 2 * sum(STOPS_S), "for each stop"
    assert "with real drives this machine would have ended the run" in bench_time["note"]


@pytest.mark.long
@pytest.mark.realtime
def test_plant_process_stall_is_a_fault_if_so_configured(
    tmp_path: Path, start: Start, listen: Listen
) -> None:
    changes = {"on_stall: stretch": "on_stall: fault"}
    file = configuration(tmp_path, {**changes, "rate_Hz: 1000": "rate_Hz: 500"}, patient=False)
    run = start("run", str(file), "--plant", entry="tests.realtime.assumed_realtime")
    listen(file).wait_for_motion(run, FAST_m_s)
    os.kill(run.find_family()["plant"], signal.SIGSTOP)
    time.sleep(0.08)
    os.kill(run.family["plant"], signal.SIGCONT)

    assert run.wait() == 1
    assert "STALE" in run.summary["faults"]
    assert "bench_time" not in run.summary


@pytest.mark.long
@pytest.mark.realtime
def test_plant_process_stopped_for_1_s_causes_a_fault(tmp_path: Path, start: Start, listen: Listen) -> None:
    run = moving(start, listen, configuration(tmp_path, patient=False))
    plant = run.find_family()["plant"]
    os.kill(plant, signal.SIGSTOP)
    time.sleep(1.0)
    os.kill(plant, signal.SIGCONT)

    assert run.wait() == 1
    rows = Log.open(run.summary["log"]).rows()
    fault = rows[np.argmax(rows["faults"] != 0)]
    assert fault["faults"] & Fault.STALE
    assert 200e6 < rows["stretched_ns"].max() < 500e6, "the pause is limited"


@pytest.mark.long
@pytest.mark.realtime
def test_run_is_parked_if_the_pauses_of_simulated_time_exceed_their_total_limit(
    tmp_path: Path, start: Start, listen: Listen
) -> None:
    changes = {"stretch_percent: 100": "stretch_percent: 0"}
    run = moving(start, listen, configuration(tmp_path, changes, patient=False))
    for _ in range(4):
        os.kill(run.pid, signal.SIGSTOP)
        time.sleep(0.15)
        os.kill(run.pid, signal.SIGCONT)
        time.sleep(0.02)

    assert run.wait() == 1
    summary = run.summary
    assert summary["ending"] == "parked"
    assert "too busy for the virtual bench" in summary["trouble"]
    assert "limits.stretch_percent" in summary["trouble"]
    assert summary["replay"]["exact"]


@pytest.mark.long
def test_bus_listeners_that_never_read_or_are_stopped_do_not_disturb_a_run(
    tmp_path: Path, start: Start, listen: Listen
) -> None:
    """Twenty that never read, and python-can's own logger, which is stopped for a while."""
    file = configuration(tmp_path, LASTING, patient=False)
    first = Participant(CHANNEL, BitTiming(1_000_000, 5_000_000), fd=True)
    deaf = [Participant(CHANNEL, None) for _ in range(20)]
    heard = tmp_path / "heard.log"
    command = [sys.executable, "-m", "can.logger", "-i", "localcan", "-c", CHANNEL, "-f", str(heard)]
    logger = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        run = moving(start, listen, file)
        os.kill(logger.pid, signal.SIGSTOP)
        time.sleep(0.3)
        os.kill(logger.pid, signal.SIGCONT)
        whole(run)
        assert heard.stat().st_size > 10_000
    finally:
        logger.kill()
        logger.wait(10)
        for each in (*deaf, first):
            each.close()
