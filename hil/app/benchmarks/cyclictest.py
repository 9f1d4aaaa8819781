"""cyclictest, where installed: the wake-ups that this kernel gives to a program in C."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Sequence

LONGEST_US = 20_000
"""Length of the histogram; later wake-ups count as this."""


def cyclictest(priority: int, period_us: int, seconds: float) -> dict[str, float] | str:
    """Return p50, p99 and max (us) of its wake-ups, or why there are none."""
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
    return percentiles(done.stdout.splitlines()) or "cyclictest gave no histogram"


def percentiles(lines: Sequence[str]) -> dict[str, float]:
    """Return p50, p99 and max from a histogram: lines `latency count`, and `# Max Latencies: n`."""
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
    total = sum(counts.values())
    if not total:
        return {}
    found = {}
    for name, share in (("p50", 0.5), ("p99", 0.99)):
        seen = 0
        for latency in sorted(counts):
            seen += counts[latency]
            if seen >= share * total:
                found[name] = float(latency)
                break
    return found | {"max": largest}
