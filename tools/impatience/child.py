"""One command as a user starts it: in a process group of its own, which a terminal's Ctrl-C reaches whole."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
import uuid
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

MARK = "HIL_IMPATIENCE"
"""Environment variable by which what a command has started is found again."""
HIL = (sys.executable, "-m", "hil.cli")
LONGEST_S = 240.0
_ROOT = str(Path(__file__).resolve().parents[2])
_GONE_S = 15.0
"""What a command has started may take so long to leave after it."""


class Outcome(NamedTuple):
    """How a command ended."""

    code: int
    """Exit code; below 0 the signal that ended it."""
    out: str
    err: str
    left: tuple[str, ...]
    """Processes that were still there afterwards."""
    wall_s: float
    end_s: float
    """From the last interrupt, or the start, to the end."""


def perform(
    command: Sequence[str],
    folder: Path,
    moments_s: Sequence[float] = (),
    environment: Mapping[str, str | None] | None = None,
    **options: Any,
) -> Outcome:
    """Run a command in `folder`, with an interrupt of its process group at each moment, s from its start.

    environment: variables to set, or with None to take away; options: as for `subprocess.Popen`.
    """
    mark = uuid.uuid4().hex
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # in the background; children inherit it
        signal.signal(signal.SIGINT, signal.default_int_handler)
    path = os.pathsep.join(filter(None, (_ROOT, os.environ.get("PYTHONPATH"))))
    changed = {**os.environ, "PYTHONPATH": path, MARK: mark, **(environment or {})}
    kept = {name: value for name, value in changed.items() if value is not None}
    with (folder / ".out").open("wb") as out, (folder / ".err").open("wb") as err:
        begun = last = time.monotonic()
        process = subprocess.Popen(
            command, cwd=folder, env=kept, stdin=subprocess.DEVNULL, stdout=out, stderr=err,
            process_group=0, **options,
        )  # fmt: skip
        for moment_s in moments_s:
            try:
                process.wait(max(0.0, begun + moment_s - time.monotonic()))
                break
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, signal.SIGINT)
                last = time.monotonic()
        try:
            code = process.wait(LONGEST_S)
        except subprocess.TimeoutExpired:
            process.kill()
            code = process.wait()
    ended = time.monotonic()
    left = _left(mark)
    while left and time.monotonic() - ended < _GONE_S:
        time.sleep(0.05)
        left = _left(mark)
    texts = [(folder / name).read_text(errors="replace") for name in (".out", ".err")]
    return Outcome(code, texts[0], texts[1], tuple(left.values()), ended - begun, ended - last)


def _left(mark: str) -> dict[int, str]:
    """Return the processes that carry a mark, by their numbers."""
    found = {}
    wanted = f"{MARK}={mark}".encode()
    for place in Path("/proc").glob("[0-9]*"):
        try:
            if wanted in (place / "environ").read_bytes().split(b"\0"):
                words = (place / "cmdline").read_bytes().split(b"\0")
                if words != [b""]:  # one that only waits to be reaped
                    found[int(place.name)] = b" ".join(words).decode(errors="replace").strip()
        except OSError:
            continue
    return found
