"""Stalls of this machine: one sleeper per processor measures how late it wakes.

The sleepers have priority over every other process (SCHED_FIFO 99), so a test's own computation does not
delay them. Without the right to that priority they measure nothing.
"""

from __future__ import annotations

import os
import subprocess
import sys
from types import TracebackType
from typing import Self

_SLEEPER = """
import os, select, sys, time
try:
    os.sched_setaffinity(0, {int(sys.argv[1])})
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(99))
except (AttributeError, OSError):
    sys.exit()
longest, last = 0.0, time.monotonic()
while not select.select([sys.stdin], [], [], 0.002)[0]:
    now = time.monotonic()
    longest, last = max(longest, now - last - 0.002), now
print(max(longest, time.monotonic() - last - 0.002))
"""


class StallWatch:
    """Runs sleeper processes of 2 ms a time while it is entered; `longest_s`: latest wake-up."""

    longest_s = 0.0

    def __enter__(self) -> Self:
        """Start a sleeper on each processor."""
        cores = sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else [0]
        self._sleepers = [
            subprocess.Popen(
                [sys.executable, "-SEc", _SLEEPER, str(core)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                text=True,
                start_new_session=True,
            )
            for core in cores
        ]
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, where: TracebackType | None
    ) -> None:
        """End the sleepers and read their results."""
        found = [sleeper.communicate(timeout=30.0)[0] for sleeper in self._sleepers]
        self.longest_s = max((float(text) for text in found if text), default=0.0)
