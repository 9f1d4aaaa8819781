"""cyclictest, where installed: the wake-ups that this kernel gives to a program in C."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

LONGEST_US = 20_000
"""Length of the histogram; later wake-ups count as this."""


def cyclictest(priority: int, period_us: int, seconds: float) -> WakeUps | str:
    """Return its wake-ups, or why there are none."""
    program = shutil.which("cyclictest")
    if program is None:
        return "cyclictest is not installed (Debian: rt-tests)"
    loops = max(1, round(seconds * 1e6 / period_us))
    command = [
        program, "--quiet", "--mlockall", "--threads=1", f"--priority={priority}",
        f"--interval={period_us}", f"--loops={loops}", f"--histogram={LONGEST_US}",
    ]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, timeout=seconds + 60.0, check=False)
    if done.returncode:
        return f"cyclictest: {(done.stderr.strip() or done.stdout.strip()).splitlines()[-1:]}"
    return read(done.stdout.splitlines()) or "cyclictest gave no histogram"


class WakeUps(NamedTuple):
    """How late its wake-ups were."""

    counts: dict[int, int]
    """us -> how many."""
    largest_us: float

    def percentiles(self) -> dict[str, float]:
        """Return p50, p99 and max, us."""
        latencies = sorted(self.counts)
        seen = np.cumsum([self.counts[latency] for latency in latencies])
        p50, p99 = (float(latencies[np.searchsorted(seen, share * seen[-1])]) for share in (0.5, 0.99))
        return {"p50": p50, "p99": p99, "max": self.largest_us}

    def later_than(self, us: float) -> float:
        """Return the share that was later, %."""
        late = sum(count for latency, count in self.counts.items() if latency > us)
        return 100.0 * late / sum(self.counts.values())


def read(lines: Sequence[str]) -> WakeUps | None:
    """Return what a histogram says: lines `latency count`, and `# Max Latencies: n`; None without counts."""
    counts: dict[int, int] = {}
    largest = 0.0
    for line in lines:
        words = line.split()
        if line.startswith("# Max Latencies:"):
            largest = float(words[-1])
        elif len(words) == 2 and words[0].isdigit() and words[1].isdigit():
            counts[int(words[0])] = int(words[1])
        elif line.startswith("# Histogram Overflows:"):
            counts[LONGEST_US] = counts.get(LONGEST_US, 0) + int(words[-1])
    return WakeUps(counts, largest) if sum(counts.values()) else None
