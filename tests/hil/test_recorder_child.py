"""The recorder as a child of the loop: how it is started, what goes through both pipes and how it is read."""

from __future__ import annotations

import io
import os
import pickle
import signal
import subprocess
import sys
from threading import Thread
from types import SimpleNamespace
from typing import Any

import pytest

from hil.record import child
from hil.record.recorder import answer
from hil.record.recording import Live

HELD = {signal.SIGINT, signal.SIGTERM, signal.SIGHUP}


@pytest.mark.parametrize("refused", [False, True])
@pytest.mark.parametrize("before", [set(), {signal.SIGUSR1, signal.SIGTERM}])
def test_a_recorder_is_started_with_the_ring_and_both_pipes_while_no_signal_can_end_it(
    monkeypatch, refused, before
):
    told: dict[str, Any] = {}

    def start(*arguments, **options):
        told.update(options, arguments=arguments, held=signal.pthread_sigmask(signal.SIG_BLOCK, ()))
        if refused:
            raise OSError("refused")
        return "process"

    monkeypatch.setattr(child, "start", start)
    ring: Any = SimpleNamespace(fd=7)
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, before)
    try:
        if refused:
            with pytest.raises(OSError, match="refused"):
                child.spawn(ring)
        else:
            assert child.spawn(ring) == "process"  # type: ignore[comparison-overlap]
        assert signal.pthread_sigmask(signal.SIG_BLOCK, ()) == mask | before, "as it was"
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
    assert told == {
        "arguments": ("hil.record", "7", str(os.getpid())),
        "environment": {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"},
        "stdin": subprocess.PIPE,
        "stdout": subprocess.PIPE,
        "pass_fds": (7,),
        "held": mask | before | HELD,
    }


@pytest.mark.parametrize(
    ("said", "ends", "heard"),
    [
        (pickle.dumps({"ready": True}) + pickle.dumps({"ticks": 3}), False, {"ready": True}),
        (pickle.dumps({"ready": True})[:-4], True, {}),
        (b"", True, {}),
        (b"", False, {"error": "the recorder did not answer within 0.015 s"}),
    ],
    ids=["two answers", "half of one", "nothing and gone", "nothing"],
)
def test_answer_is_the_first_complete_message_or_empty_if_the_recorder_ended(said, ends, heard):
    reads, writes = os.pipe()
    with os.fdopen(reads, "rb") as pipe, os.fdopen(writes, "wb", buffering=0) as out:
        out.write(said)
        if ends:
            out.close()
        process: Any = SimpleNamespace(stdout=pipe)
        assert child.answer(process, 0.015) == heard


class Ending:
    """A process whose pipes may be broken, and which may not end."""

    def __init__(self, *, broken=False, lasts=False):
        self.did: list[Any] = []
        self.broken, self.lasts = broken, lasts
        self.stdin, self.stdout = (
            SimpleNamespace(close=lambda n=name: self.close(n)) for name in ("in", "out")
        )

    def close(self, name):
        self.did.append(name)
        if self.broken:
            raise BrokenPipeError

    def wait(self, timeout_s):
        self.did.append(timeout_s)
        if self.lasts:
            raise subprocess.TimeoutExpired("hil", timeout_s)


@pytest.mark.parametrize("lasts", [False, True])
@pytest.mark.parametrize("broken", [False, True])
def test_a_recorder_at_its_end_has_both_pipes_closed_and_five_seconds_to_go(broken, lasts):
    process: Any = Ending(broken=broken, lasts=lasts)
    child.finish(process)
    assert process.did == ["in", "out", 5.0]


def test_a_recorder_without_pipes_is_reaped_all_the_same():
    process: Any = Ending()
    process.stdin = process.stdout = None
    child.finish(process)
    assert process.did == [5.0]


# -- both ends -------------------------------------------------------------------------------------------------


def test_a_set_up_of_any_size_comes_whole_and_what_follows_comes_next():
    reads, writes = os.pipe()
    messages: list[dict[str, Any]] = [
        {"attachments": [("a", bytes(3_000_000)), ("empty", b"")], "live": Live()},
        {"x": "1"},
    ]
    with os.fdopen(reads, "rb") as pipe, os.fdopen(writes, "wb") as out:
        process: Any = SimpleNamespace(stdin=out)

        def send():
            for each in messages:
                child.send(process, each)

        sender = Thread(target=send)
        sender.start()
        assert [child.receive(pipe), child.receive(pipe)] == messages
        sender.join()
        out.close()
        assert child.receive(pipe) is None


def test_an_answer_is_none_where_nobody_listens(capfdbinary, monkeypatch):
    answer({"ready": True})
    answer({"ticks": 3})
    said = io.BytesIO(capfdbinary.readouterr().out)
    assert [child.receive(said), child.receive(said), child.receive(said)] == [
        {"ready": True},
        {"ticks": 3},
        None,
    ]
    reads, writes = os.pipe()
    os.close(reads)
    with os.fdopen(writes, "w") as out:
        monkeypatch.setattr(sys, "stdout", out)
        answer({"ready": True})
