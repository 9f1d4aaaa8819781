"""A runtime folder for each test of a bus; participants and processes on its localcan channel `t`."""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from drivers.can.localcan.participant import DEFAULT_TIMING, Participant

PREAMBLE = """
import os, signal, sys, time
from drivers.can.localcan.participant import DEFAULT_TIMING, Participant
from drivers.frame_array import received_frames, sent_array
from drivers.protocol import Frame
node = Participant("t", DEFAULT_TIMING, fd=True)
clock, give, take = node.clock, node.send, node.receive
node.send = lambda frames: give(sent_array(frames))
node.receive = lambda: [*received_frames(take())]
print("ready", flush=True)
"""


@pytest.fixture
def runtime(monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    # not tmp_path: a socket's path has to be shorter than 108 characters
    folder = tempfile.mkdtemp(prefix="lc")
    monkeypatch.setenv("XDG_RUNTIME_DIR", folder)
    yield Path(folder)
    shutil.rmtree(folder)


@pytest.fixture
def join(runtime: Path) -> Iterator[Callable[..., Participant]]:
    """Join the channel in this process."""
    with ExitStack() as stack:

        def begin(timing: Any = DEFAULT_TIMING, fd: bool | None = True, **options: Any) -> Participant:
            node = Participant("t", timing, fd=fd, **options)
            stack.callback(node.close)
            return node

        yield begin


@pytest.fixture
def child(runtime: Path) -> Iterator[Callable[[str], subprocess.Popen[str]]]:
    """Start a process that joins the channel as `node` and runs code; it is killed at the end."""
    with ExitStack() as stack:

        def begin(code: str) -> subprocess.Popen[str]:
            command = [sys.executable, "-c", PREAMBLE + code]
            started = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
            process = stack.enter_context(started)
            stack.callback(process.kill)
            assert process.stdout is not None
            assert process.stdout.readline() == "ready\n"
            return process

        yield begin
