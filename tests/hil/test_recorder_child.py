"""The recorder as a child of the loop: how it is started, what goes through both pipes and how it is read."""

from __future__ import annotations

import io
import json
import os
import signal
import struct
import subprocess
import sys
from types import SimpleNamespace
from typing import Any

import pytest

from hil.record import child
from hil.record.recorder import answer, read_exactly, read_setup

HELD = {signal.SIGINT, signal.SIGALRM, signal.SIGTERM, signal.SIGHUP}


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


class Pipe(io.BytesIO):
    """A pipe that hands over what was written when it is told to."""

    heard = b""

    def flush(self):
        self.heard = self.getvalue()


def test_a_set_up_is_sent_whole_its_length_first_and_the_attachments_behind_it():
    pipe = Pipe()
    process: Any = SimpleNamespace(stdin=pipe)
    child.set_up(process, {"x": "y" * 300}, [b"one", b"", b"three"])
    text = b'{"x": "' + b"y" * 300 + b'"}'
    assert pipe.heard == struct.pack("<Q", len(text)) + text + b"onethree"
    child.write_all(process, b"more")
    assert pipe.heard.endswith(b"threemore")


@pytest.mark.parametrize(
    ("said", "ends", "heard"),
    [
        (b'{"ready": true}\n{"ticks": 3}\n', False, {"ready": True}),
        (b'{"ready": true}', True, {}),
        (b"", True, {}),
        (b"", False, {"error": "the recorder did not answer within 0.015 s"}),
    ],
    ids=["two lines", "half a line", "nothing and gone", "nothing"],
)
def test_an_answer_is_the_first_whole_line_and_nothing_where_the_recorder_is_gone(said, ends, heard):
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


# -- its own end of the pipes ----------------------------------------------------------------------------------


@pytest.fixture
def pipe():
    reads, writes = os.pipe()
    with os.fdopen(writes, "wb", buffering=0) as out:
        yield reads, out
    os.close(reads)


def test_a_set_up_is_a_length_an_object_and_the_attachments_it_names(pipe):
    reads, out = pipe
    text = json.dumps({"attachments": [["a", 3], ["empty", 0], ["b", 2]], "x": "y" * 300}).encode()
    out.write(struct.pack("<Q", len(text)) + text + b"abcdemore")
    setup, attachments = read_setup(reads)
    assert setup == json.loads(text)
    assert attachments == [("a", b"abc"), ("empty", b""), ("b", b"de")]
    assert read_exactly(reads, 4) == b"more"


def test_bytes_that_come_in_pieces_are_read_to_the_last_one_and_no_further(monkeypatch):
    pieces, asked = [b"ab", b"c", b"def"], []

    def part(fd, count):
        asked.append((fd, count))
        return pieces.pop(0)

    monkeypatch.setattr(os, "read", part)
    assert read_exactly(7, 6) == b"abcdef"
    assert asked == [(7, 6), (7, 4), (7, 3)]
    pieces[:] = [b"ab", b""]
    with pytest.raises(EOFError):
        read_exactly(7, 3)


def test_an_answer_is_one_line_and_none_where_nobody_listens(capfd, monkeypatch):
    answer({"ready": True})
    answer({"ticks": 3})
    assert capfd.readouterr().out == '{"ready": true}\n{"ticks": 3}\n'
    reads, writes = os.pipe()
    os.close(reads)
    with os.fdopen(writes, "w") as out:
        monkeypatch.setattr(sys, "stdout", out)
        answer({"ready": True})
