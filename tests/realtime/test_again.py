"""A machine that stalls in mid-motion: with the plant on it, the run is made once more, slower."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from drivers.errors import ConfigurationError
from hil.app import again
from hil.app.configuration import load
from hil.log import Log
from tests.realtime.bench import Listener, Process, configuration

pytestmark = pytest.mark.realtime(patient=True)

FAST_m_s = 0.2
STALL_S = 0.12
TIMING = {
    "rate_Hz: 1000": "rate_Hz: 250",
    "watchdog_ms: 10 ": "watchdog_ms: 40 ",
    "stale_fault_ticks: 5": "stale_fault_ticks: 9\n  missed_stop_ticks: 9",
}
"""A stall of 36 ms ends the run."""


def stall(run: Process) -> None:
    plant = run.find_family()["plant"]
    os.kill(plant, signal.SIGSTOP)
    time.sleep(STALL_S)
    os.kill(plant, signal.SIGCONT)


def test_a_stall_is_followed_by_a_run_at_a_rate_that_outlasts_it(
    tmp_path: Path, start: Callable[..., Process], listen: Callable[[Path], Listener]
) -> None:
    file = configuration(tmp_path, TIMING, short=True, patient=False)
    asked = tmp_path / "asked.mcap"
    run = start("run", str(file), "--plant", "--log", str(asked), entry="tests.realtime.steady")
    listen(file).wait_for_motion(run, FAST_m_s)
    stall(run)

    code, summary = run.wait(), run.summary
    assert code == 0, run.errors
    assert summary["rate_Hz"] == 125.0
    assert summary["replay"]["exact"]
    assert summary["log"] == str(asked)
    before = summary["stalled_run"]
    assert before["rate_Hz"] == 250.0
    assert before["log"] == str(tmp_path / "asked-stalled.mcap")
    assert before["trouble"] in run.errors
    assert "once more from the start: the loop runs at 125 Hz instead of 250 Hz" in run.errors
    assert Log.open(asked).metadata["hil"]["rate_Hz"] == "125.0"
    stalled = Log.open(before["log"])
    assert stalled.summary.closed == "clean"
    assert len(stalled.rows()) == before["ticks"]
    assert (tmp_path / "asked-plant.mcap").exists()
    assert (tmp_path / "asked-stalled-plant.mcap").exists()


def test_a_machine_that_may_not_be_slowed_ends_with_the_stall(
    tmp_path: Path, start: Callable[..., Process], listen: Callable[[Path], Listener]
) -> None:
    changes = {**TIMING, "without_realtime: slow ": "without_realtime: refuse "}
    file = configuration(tmp_path, changes, short=True, patient=False)
    run = start("run", str(file), "--plant", entry="tests.realtime.steady")
    listen(file).wait_for_motion(run, FAST_m_s)
    stall(run)

    assert run.wait() == 1
    assert "stalled_run" not in run.summary
    assert len(list((tmp_path / "runs").glob("*.mcap"))) == 2


def test_a_configuration_that_cannot_run_slower_leaves_it_at_the_stalled_run(tmp_path, monkeypatch):
    log = tmp_path / "one.mcap"
    calls = []

    def run_daemon(configuration, *, log, slow="", **_):
        calls.append(slow)
        if slow:
            raise ConfigurationError("the controller is made for 1000 Hz")
        for end in (".mcap", "-plant.mcap"):
            log.with_name(log.stem + end).write_bytes(b"first")
        return {"stalled": True, "trouble": "latched fault STALE", "rate_Hz": 1000.0, "log": str(log)}

    monkeypatch.setattr(again, "run_daemon", run_daemon)
    summary = again.run_with_plant(load("virtual"), log=log)
    assert [bool(slow) for slow in calls] == [False, True]
    assert "stalled_run" not in summary
    assert sorted(p.name for p in tmp_path.iterdir()) == ["one-plant.mcap", "one.mcap"]


def test_what_was_set_aside_before_is_not_overwritten(tmp_path, monkeypatch):
    log = tmp_path / "one.mcap"
    (tmp_path / "one-stalled.png").write_bytes(b"older")

    def run_daemon(configuration, *, log, slow="", **_):
        assert not log.exists()
        log.write_bytes(b"second" if slow else b"first")
        return {"stalled": not slow, "trouble": "latched fault STALE", "rate_Hz": 1000.0, "log": str(log)}

    monkeypatch.setattr(again, "run_daemon", run_daemon)
    summary = again.run_with_plant(load("virtual"), log=log)
    assert summary["stalled_run"]["log"] == str(tmp_path / "one-stalled-2.mcap")
    assert {p.name: p.read_bytes() for p in tmp_path.iterdir()} == {
        "one.mcap": b"second", "one-stalled-2.mcap": b"first", "one-stalled.png": b"older",
    }  # fmt: skip
