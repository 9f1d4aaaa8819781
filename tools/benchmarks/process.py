"""Processor time and memory of another process, from /proc."""

import os
from pathlib import Path


def cpu_s(pid: int) -> float:
    """Processor time that a process has used, user and system, s; to 10 ms."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def resident_MB(pid: int) -> float:
    """Resident memory of a process, MB (1024^2 bytes). Raises OSError when it has ended."""
    for line in Path(f"/proc/{pid}/status").read_text().splitlines():
        if line.startswith("VmRSS:"):
            return int(line.split()[1]) / 1024.0
    raise ProcessLookupError(f"process {pid} has ended")
