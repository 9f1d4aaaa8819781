"""candump next to the programs under test, and a reader of its log."""

from __future__ import annotations

import contextlib
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple


class Heard(NamedTuple):
    """One line of candump's log."""

    t: float
    identifier: int
    fd: bool
    data: bytes


@contextlib.contextmanager
def candump(interface: str, log: Path) -> Iterator[None]:
    """Run candump, which writes every frame on `interface` to `log`, during the block."""
    listeners = Path("/proc/net/can/rcvlist_all")  # the kernel's list of sockets without a filter
    with log.open("wb") as sink:
        process = subprocess.Popen(["candump", "-L", interface], stdout=sink)
        for _ in range(100):
            if listeners.exists() and f" {interface} " in listeners.read_text():
                break
            time.sleep(0.02)
        try:
            yield
            time.sleep(0.2)
        finally:
            process.terminate()
            process.wait(5.0)


def read_log(log: Path) -> list[Heard]:
    """Read ``(seconds) interface id#data`` and ``id##<flags>data`` lines."""
    heard = []
    for line in log.read_text().splitlines():
        stamp, _interface, frame = line.split()[:3]
        identifier, _, data = frame.partition("#")
        fd = data.startswith("#")
        heard.append(
            Heard(float(stamp.strip("()")), int(identifier, 16), fd, bytes.fromhex(data[2:] if fd else data))
        )
    return heard
