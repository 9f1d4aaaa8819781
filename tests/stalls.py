"""How long this machine stood still: one sleeper a processor, which notes how late it wakes.

The sleepers are above every other process (SCHED_FIFO 99): what a test itself computes does not delay them.
Where that is not allowed they say nothing.
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
    """While it is entered, processes of its own sleep 2 ms at a time; `longest_s` is how late one woke."""

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
        """End them and read what they saw."""
        found = [sleeper.communicate(timeout=30.0)[0] for sleeper in self._sleepers]
        self.longest_s = max((float(text) for text in found if text), default=0.0)
