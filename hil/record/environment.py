"""What a log says about the machine and the software that wrote it."""

import os
import platform
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
_POLICIES = {os.SCHED_OTHER: "other", os.SCHED_FIFO: "fifo", os.SCHED_RR: "rr", os.SCHED_BATCH: "batch"}
_CLOCKSOURCE = Path("/sys/devices/system/clocksource/clocksource0/current_clocksource")


def product_version() -> str:
    """Return the version of this product."""
    return _version("hexapod-hil") or "unknown"


def environment() -> dict[str, str]:
    """Return versions, git state, kernel, CPU and clock of this process."""
    found = {
        "version": product_version(),
        "python": f"{platform.python_implementation()} {platform.python_version()}",
        "git": _git(),
        "system": platform.system(),
        "kernel": f"{platform.release()} {platform.version()}",
        "machine": platform.machine(),
        "cpu": _cpu(),
        "cpus": str(os.cpu_count() or ""),
        "clock": _clock(),
        "byte_order": sys.byteorder,
    }
    found |= {f"package.{name}": _version(name) for name in PACKAGES}
    return {key: value for key, value in found.items() if value}


def scheduling() -> dict[str, str]:
    """Return scheduler and processors of this process: those of a loop only while it runs."""
    return {"scheduler": _scheduler(), "affinity": ",".join(map(str, sorted(os.sched_getaffinity(0))))}


@cache
def _version(name: str) -> str:
    from importlib.metadata import PackageNotFoundError, version  # noqa: PLC0415 - no recorder pays for it

    try:
        return version(name)
    except PackageNotFoundError:
        return ""


@cache
def _git() -> str:
    """Return commit (and -dirty) when the sources lie in a repository of their own."""
    root = Path(__file__).resolve().parents[2]
    if not (root / ".git").exists():
        return ""
    try:
        done = subprocess.run(
            ["git", "-C", str(root), "describe", "--always", "--dirty", "--abbrev=40"],
            capture_output=True,
            text=True,
            timeout=2.0,
            check=True,
        )
    except (OSError, subprocess.SubprocessError):
        return ""
    return done.stdout.strip()


def _cpu() -> str:
    lines = _read(Path("/proc/cpuinfo")).splitlines()
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor()


def _scheduler() -> str:
    policy = os.sched_getscheduler(0)
    name = _POLICIES.get(policy & ~os.SCHED_RESET_ON_FORK, policy)
    return f"{name} {os.sched_getparam(0).sched_priority}"


def _clock() -> str:
    return _read(_CLOCKSOURCE).strip()


def _read(path: Path) -> str:
    try:
        return path.read_text(errors="replace")
    except OSError:
        return ""
