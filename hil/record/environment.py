"""Description of the machine and the software that wrote a log."""

import os
import platform
import re
import subprocess
import sys
from functools import cache
from pathlib import Path

PACKAGES = (
    "numpy",
    "numba",
    "llvmlite",
    "scipy",
    "python-can",
    "cantools",
    "fmpy",
    "mcap",
    "protobuf",
    "pydantic",
    "zstandard",
)
_POLICIES = {0: "other", 1: "fifo", 2: "rr", 3: "batch"}


def product_version() -> str:
    """Installed version of hexapod-hil, or `unknown`."""
    return _version("hexapod-hil") or "unknown"


def environment() -> dict[str, str]:
    """Software versions, git commit, kernel, CPU and clock source of this process, as text by name."""
    cpu = re.search(r"^model name\s*:\s*(.*)", _read("/proc/cpuinfo"), re.MULTILINE)
    found = {
        "version": product_version(),
        "python": f"{platform.python_implementation()} {platform.python_version()}",
        "git": _git(),
        "system": platform.system(),
        "kernel": f"{platform.release()} {platform.version()}",
        "machine": platform.machine(),
        "cpu": cpu[1].strip() if cpu else platform.processor(),
        "cpus": str(os.cpu_count() or ""),
        "clock": _read("/sys/devices/system/clocksource/clocksource0/current_clocksource").strip(),
        "byte_order": sys.byteorder,
    }
    found |= {f"package.{name}": _version(name) for name in PACKAGES}
    return {key: value for key, value in found.items() if value}


def scheduling() -> dict[str, str]:
    """Scheduling policy, priority and allowed processors of this process now; nothing outside of Linux."""
    if not hasattr(os, "sched_getscheduler"):
        return {}
    policy = os.sched_getscheduler(0)
    name = _POLICIES.get(policy & ~os.SCHED_RESET_ON_FORK, policy)
    processors = ",".join(map(str, sorted(os.sched_getaffinity(0))))
    return {"scheduler": f"{name} {os.sched_getparam(0).sched_priority}", "affinity": processors}


@cache
def _version(name: str) -> str:
    from importlib.metadata import PackageNotFoundError, version  # noqa: PLC0415 - no recorder pays for it

    try:
        return version(name)
    except PackageNotFoundError:
        return ""


@cache
def _git() -> str:
    """Git commit of the sources, with -dirty if they are changed; empty outside of a repository."""
    root = Path(__file__).resolve().parents[2]
    command = ["git", "-C", str(root), "describe", "--always", "--dirty", "--abbrev=40"]
    if not (root / ".git").exists():
        return ""
    try:
        return subprocess.run(command, capture_output=True, text=True, timeout=2.0, check=True).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return ""


def _read(path: str) -> str:
    try:
        return Path(path).read_text(errors="replace")
    except OSError:
        return ""
