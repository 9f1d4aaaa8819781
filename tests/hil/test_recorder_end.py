"""The recorder ends with its producer, whoever else holds the pipe between the two."""

import contextlib
import os
import pickle
import subprocess
from types import SimpleNamespace
from typing import Any

import pytest

from hil.record import Recording
from hil.record.recorder import _Control

LONG_S = 10.0
"""More than a killed process takes to be gone."""


@pytest.fixture
def held():
    """Both ends of a pipe: the one that is written to stays open, as in a child that outlives its parent."""
    reads, writes = os.pipe()
    with os.fdopen(reads, "rb") as pipe:
        yield pipe, writes
    with contextlib.suppress(OSError):
        os.close(writes)


@pytest.fixture
def producer(monkeypatch):
    """A process that waits, in the place of the parent."""
    with subprocess.Popen(["cat"], stdin=subprocess.PIPE) as process:
        monkeypatch.setattr(os, "getppid", lambda: process.pid)
        yield process
        process.kill()


def test_a_producer_that_was_killed_has_ended_although_a_child_of_it_holds_the_pipe(held, producer):
    control = _Control(held[0], producer.pid)
    assert not control.ended(0.0)
    producer.kill()
    assert control.ended(LONG_S)
    assert control.ended(0.0), "and stays so"
    assert control.summary is None


def test_a_producer_that_had_died_before_it_was_watched_has_ended(held, producer, monkeypatch):
    monkeypatch.setattr(os, "getppid", lambda: 1)
    assert _Control(held[0], producer.pid).ended(0.0)


def test_a_producer_that_lives_has_ended_once_its_summary_is_whole(held, producer):
    control = _Control(held[0], producer.pid)
    assert not control.ended(0.0)
    os.write(held[1], pickle.dumps({"ending": "PARKED"}))
    assert control.ended(LONG_S)
    assert control.summary == {"ending": "PARKED"}


@pytest.mark.parametrize("more", [pickle.dumps({}), pickle.dumps({})[:3], 2 * pickle.dumps({})])
def test_the_first_summary_counts_where_an_interrupted_close_sends_more(held, producer, more):
    control = _Control(held[0], producer.pid)
    os.write(held[1], pickle.dumps({"ending": "PARKED"}) + more)
    assert control.ended(LONG_S)
    assert control.summary == {"ending": "PARKED"}


def test_truncated_summary_counts_as_none(held, producer):
    control = _Control(held[0], producer.pid)
    os.write(held[1], pickle.dumps({"ending": "PARKED"})[:-5])
    os.close(held[1])
    assert control.ended(LONG_S)
    assert control.summary is None


def test_a_producer_that_has_closed_its_pipe_has_ended(held, producer):
    control = _Control(held[0], producer.pid)
    os.close(held[1])
    assert control.ended(LONG_S)
    assert control.summary is None


def test_a_recorder_that_has_closed_its_log_ends_without_a_word(tmp_path, capfd):
    recording = Recording.start(tmp_path / "a.mcap", configuration="", lockstep=True)
    assert recording.close().complete
    assert recording._process.returncode == 0
    assert capfd.readouterr() == ("", "")


def test_a_look_for_the_end_waits_as_long_as_it_is_told_in_milliseconds(held, producer):
    control = _Control(held[0], producer.pid)
    asked: list[float] = []

    def poll(ms):
        asked.append(ms)
        return []

    watch: Any = SimpleNamespace(poll=poll)
    control._poll = watch
    assert not control.ended(0.25)
    assert asked == [250.0]


@pytest.mark.parametrize("lacks", [AttributeError, ProcessLookupError])
def test_where_processes_cannot_be_watched_the_pipe_says_when_the_producer_has_ended(
    held, producer, monkeypatch, lacks
):
    def refuse(_):
        raise lacks

    monkeypatch.setattr(os, "pidfd_open", refuse)
    control = _Control(held[0], producer.pid)
    assert not control.ended(0.0)
    os.close(held[1])
    assert control.ended(LONG_S)
