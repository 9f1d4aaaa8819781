"""A full disk: the log is closed with what fits and says so, at its producer and in its file."""

from __future__ import annotations

import resource

import pytest

from hil.app import compose
from hil.app.configuration.configuration import load
from hil.app.replay import replay_log
from hil.app.sim import command
from hil.record import Recording
from hil.record.log import Log
from hil.record.recording import RecorderEndedError
from tests.hil.samples import random_ticks, record

ROOM = 900_000
"""Bytes that the recorder may write."""


def lessen(recording, room=ROOM):
    """Let the recorder's files grow no further: to it that is a full disk."""
    resource.prlimit(recording._process.pid, resource.RLIMIT_FSIZE, (room, room))


def test_a_full_disk_closes_the_log_with_what_fits(tmp_path):
    path = tmp_path / "a.mcap"
    recording = Recording.start(path, configuration="kept: true\n")
    lessen(recording)
    record(recording, random_ticks(3000))
    summary = recording.close({"ending": "PARKED"})
    assert summary.error.startswith("disk_full: ")
    assert str(path) in summary.error
    assert (summary.gave_up, summary.complete) == (True, False)
    log = Log.open(path)
    assert 0 < summary.ticks == len(log.rows()) == log.summary.ticks
    assert summary.ticks + summary.lost + summary.dropped == 3000
    assert log.summary.closed == "disk_full"
    assert log.rows()["tick"].tolist() == list(range(summary.ticks))
    assert path.stat().st_size == summary.size_bytes <= ROOM


def test_a_disk_without_room_for_one_tick_leaves_no_log(tmp_path):
    recording = Recording.start(tmp_path / "a.mcap", configuration="")
    lessen(recording, (tmp_path / "a.mcap").stat().st_size + 10)
    record(recording, random_ticks(300))
    summary = recording.close()
    assert "disk_full" in summary.error
    assert (summary.ticks, summary.gave_up) == (0, True)
    assert not any(tmp_path.iterdir())


def test_in_lockstep_the_producer_gets_the_reason(tmp_path):
    recording = Recording.start(tmp_path / "a.mcap", configuration="", lockstep=True, ring_ticks=256)
    lessen(recording)
    with pytest.raises(RecorderEndedError, match=r"a\.mcap: disk_full: "):
        record(recording, random_ticks(3000))
    assert recording.close().gave_up


def test_a_simulation_on_a_full_disk_fails_and_its_log_replays(tmp_path, monkeypatch):
    def started(*arguments, **options):
        recording = compose.record(*arguments, **options)
        lessen(recording, 300_000)
        return recording

    monkeypatch.setattr(command, "record", started)
    summary = command.simulate(load("virtual"), log=tmp_path / "a.mcap", duration_s=0.3)
    assert not summary["success"]
    assert summary["trouble"].startswith("disk_full: ")
    assert summary["ticks"] > 100
    comparison, _ = replay_log(tmp_path / "a.mcap")
    assert (comparison.exact, comparison.ticks) == (True, summary["ticks"])
