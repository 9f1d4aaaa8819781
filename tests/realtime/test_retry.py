"""A machine that stalls in mid-motion: with the plant on it, the run is made once more, slower."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from drivers.errors import ConfigurationError
from hil.app.configuration.configuration import load
from hil.app.run import retry
from hil.record.log import Log
from tests.realtime.rig import Listener, Process, configuration

FAST_m_s = 0.2
STALL_S = 0.12
TIMING = {
    "rate_Hz: 1000": "rate_Hz: 250",
    "watchdog_ms: 10 ": "watchdog_ms: 40 ",
    "stale_fault_ticks: 5": "stale_fault_ticks: 9\n  missed_stop_ticks: 9",
}
"""A stall of 36 ms ends the run."""


def stall(run: Process) -> None:
    """Stop the loop for a while, unless this machine has done so by itself."""
    if "once more" not in run.errors:
        os.kill(run.pid, signal.SIGSTOP)
        time.sleep(STALL_S)
        os.kill(run.pid, signal.SIGCONT)


@pytest.mark.realtime
def test_a_stall_is_followed_by_a_run_at_a_rate_that_outlasts_it(
    tmp_path: Path, start: Callable[..., Process], listen: Callable[[Path], Listener]
) -> None:
    file = configuration(tmp_path, TIMING, short=True, patient=False)
    asked = tmp_path / "asked.log"
    older = tmp_path / "asked.mcap"
    older.write_bytes(b"of somebody else")
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
    assert before["log"] == str(tmp_path / "asked-stalled.log")
    assert before["trouble"] in run.errors
    assert "retry from the start: the loop runs at 125 Hz instead of 250 Hz" in run.errors
    assert Log.open(asked).metadata["hil"]["rate_Hz"] == "125.0"
    stalled = Log.open(before["log"])
    assert stalled.summary.closed == "clean"
    assert len(stalled.rows()) == before["ticks"]
    assert (tmp_path / "asked-plant.mcap").exists()
    assert (tmp_path / "asked-stalled-plant.mcap").exists()
    assert older.read_bytes() == b"of somebody else"


def write(log: Path, text: bytes, **more: object) -> dict[str, object]:
    """Leave the files of a run and return its summary."""
    plant, picture = log.with_name(f"{log.stem}-plant.mcap"), log.with_suffix(".png")
    for file in (log, plant, picture):
        file.write_bytes(text)
    return {
        "stalled": True, "trouble": "latched fault STALE", "rate_Hz": 1000.0, "log": str(log),
        "plant": {"log": str(plant)}, "picture": str(picture), **more,
    }  # fmt: skip


def test_where_the_second_run_does_not_begin_the_first_one_counts(tmp_path, monkeypatch):
    def run_daemon(configuration, *, log, slow="", **_):
        if slow:
            raise ConfigurationError("the controller is made for 1000 Hz")
        return write(log, b"first")

    monkeypatch.setattr(retry, "run_daemon", run_daemon)
    summary = retry.run_with_plant(load("virtual"), log=tmp_path / "one.mcap")
    kept = [tmp_path / f"one-stalled{end}" for end in (".mcap", "-plant.mcap", ".png")]
    assert [summary["log"], summary["plant"]["log"], summary["picture"]] == [str(file) for file in kept]
    assert sorted(tmp_path.iterdir()) == sorted(kept)
    assert "stalled_run" not in summary


def test_what_was_set_aside_before_is_not_overwritten(tmp_path, monkeypatch):
    log = tmp_path / "one.mcap"
    (tmp_path / "one-stalled.png").write_bytes(b"older")

    def run_daemon(configuration, *, log, slow="", **_):
        assert not log.exists()
        return write(log, b"second" if slow else b"first", stalled=not slow)

    monkeypatch.setattr(retry, "run_daemon", run_daemon)
    summary = retry.run_with_plant(load("virtual"), log=log)
    assert summary["log"] == str(log)
    assert summary["stalled_run"]["log"] == str(tmp_path / "one-stalled-2.mcap")
    ends = (".mcap", "-plant.mcap", ".png")
    expected = {f"one{end}": b"second" for end in ends} | {f"one-stalled-2{end}": b"first" for end in ends}
    assert {p.name: p.read_bytes() for p in tmp_path.iterdir()} == expected | {"one-stalled.png": b"older"}
