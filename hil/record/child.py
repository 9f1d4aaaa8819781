"""The recorder as a child process: start it, set it up, hear its answer, reap it."""

import contextlib
import json
import os
import select
import signal
import struct
import subprocess
from collections.abc import Mapping, Sequence
from typing import Any

from drivers.child_process import start
from hil.record.ring import Ring


def spawn(ring: Ring) -> subprocess.Popen[bytes]:
    """Start the recorder with the ring and two pipes."""
    # a Ctrl-C while the recorder starts must not end it: it inherits the mask and opens it when it is ready
    held = {signal.SIGINT, signal.SIGALRM, signal.SIGTERM, signal.SIGHUP}  # SIGALRM: a press that is repeated
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, held)
    try:
        return start(
            "hil.record",
            str(ring.fd),
            str(os.getpid()),
            environment={"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            pass_fds=(ring.fd,),
        )
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)


def set_up(
    process: subprocess.Popen[bytes], setup: Mapping[str, object], attachments: Sequence[bytes]
) -> None:
    """Send what the recorder reads first: length, JSON, attachments."""
    text = json.dumps(setup).encode()
    write_all(process, struct.pack("<Q", len(text)) + text)
    for data in attachments:
        write_all(process, data)


def write_all(process: subprocess.Popen[bytes], data: bytes) -> None:
    """Send bytes to the recorder. Raises OSError where it is gone."""
    assert process.stdin is not None
    process.stdin.write(data)
    process.stdin.flush()


def answer(process: subprocess.Popen[bytes], timeout_s: float) -> dict[str, Any]:
    """Return the recorder's next line, or {} when it is gone or does not answer in time."""
    assert process.stdout is not None
    if not select.select([process.stdout], [], [], timeout_s)[0]:
        return {"error": f"the recorder did not answer within {timeout_s:g} s"}
    line = process.stdout.readline()
    reply: dict[str, Any] = json.loads(line) if line.endswith(b"\n") else {}
    return reply


def finish(process: subprocess.Popen[bytes]) -> None:
    """Close the pipes and reap."""
    for pipe in (process.stdin, process.stdout):
        if pipe is not None:
            with contextlib.suppress(OSError):
                pipe.close()
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(5.0)
