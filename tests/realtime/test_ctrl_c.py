"""Ctrl-C during motion, sent to the whole process group as by a terminal."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from drivers.signals import LEGS, DriveFault, DriveState, Fault, Mode
from hil.record.log import Log
from tests.realtime.rig import FIFO, LASTING, Listener, Process, configuration

pytestmark = pytest.mark.realtime(patient=True)

Start = Callable[..., Process]
Listen = Callable[[Path], Listener]

ALONG = np.array([0.25, 0.5, -0.25])
"""Direction of the path of configs/virtual.yaml, m."""


def test_first_ctrl_c_stops_the_platform_along_its_path_and_parks_with_success(
    tmp_path: Path, start: Start, listen: Listen
) -> None:
    file = configuration(tmp_path, LASTING)
    run = start("run", str(file), "--plant")
    listen(file).wait_for_motion(run, 0.7)

    run.interrupt()

    code, summary = run.wait(), run.summary
    assert (code, summary["success"], summary["ending"]) == (0, True, "parked on request")
    assert summary["trouble"] is None
    assert summary["replay"]["exact"]
    assert summary["dropped_ticks"] == 0
    assert "Traceback" not in run.errors
    if FIFO:
        assert summary["rate_Hz"] == 500
        assert "SCHED_FIFO" in summary["real_time"]["granted"]
        end = Log.open(summary["log"]).metadata["summary"]
        assert end["scheduler"].startswith("fifo ")
        assert json.loads(end["granted"]) == summary["real_time"]["granted"]
        assert run.messages == []

    rows = Log.open(summary["log"]).rows()
    modes = [Mode(int(m)) for m in rows["mode"][np.flatnonzero(np.diff(rows["mode"], prepend=-1))]]
    assert modes[-5:] == [Mode.TRACKING, Mode.STOPPING, Mode.PARKING, Mode.UNLOADING, Mode.PARKED]
    stopping = rows[rows["mode"] == Mode.STOPPING]
    off_path = np.cross(stopping["p_d"] - [0, 0, 1], ALONG / np.linalg.norm(ALONG))
    assert np.abs(off_path).max() < 1e-9
    assert np.abs(stopping["q_d"] - stopping["q"]).max() < 0.005
    assert np.linalg.norm(stopping["twist_d"][0, :3]) > 0.2
    assert np.linalg.norm(stopping["twist_d"][-1, :3]) < 1e-3

    last = Log.open(summary["plant"]["log"]).rows()[-1]
    assert (last["brake"] == 1).all()
    assert (last["drive_state"] == DriveState.OFF).all()
    assert np.abs(last["rate"]).max() < 1e-6


@pytest.mark.long
def test_second_ctrl_c_causes_an_emergency_stop_and_the_run_fails(
    tmp_path: Path, start: Start, listen: Listen
) -> None:
    file = configuration(tmp_path, LASTING)
    run = start("run", str(file), "--plant")
    listen(file).wait_for_motion(run, 0.7)

    run.interrupt()
    time.sleep(0.05)  # at once would be one signal: the kernel does not count pending ones
    run.interrupt()

    code, summary = run.wait(), run.summary
    assert (code, summary["success"], summary["ending"]) == (1, False, "fault")
    assert summary["faults"] == [Fault.ESTOP.name]
    assert "ESTOP" in summary["trouble"]
    assert "ESTOP" in run.errors
    assert "Traceback" not in run.errors
    assert summary["replay"]["exact"]
    last = Log.open(summary["plant"]["log"]).rows()[-1]
    assert last["drive_fault"].tolist() == [DriveFault.ESTOP] * LEGS
    assert (last["brake"] == 1).all()


@pytest.mark.long
def test_ctrl_c_before_the_loop_begins_ends_the_run_with_one_message(tmp_path: Path, start: Start) -> None:
    file = configuration(tmp_path)
    run = start("run", str(file), "--plant")
    run.wait_for_child("hil.cli plant")

    run.interrupt()

    assert run.wait() == 130
    assert run.messages == ["hil: interrupted before the loop began: nothing has moved"]
