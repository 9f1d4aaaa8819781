"""One fuzz case: an input is damaged according to its seed and read; time, memory, output are checked."""

from __future__ import annotations

import contextlib
import re
import shutil
import time
import traceback
import warnings
from pathlib import Path
from random import Random
from typing import NamedTuple

from drivers.errors import HilError
from tools.fuzz.targets import TARGETS, Stock

LONGEST_S = 5.0
"""Limit of a case's processor time: other processes may use the machine."""
MOST_MB = 250
"""Limit of the memory of a case; the first call of a command takes about as much."""
_STATUS = Path("/proc/self/status")
_CLEAR = Path("/proc/self/clear_refs")
_TASKS = Path("/proc/self/task")
_CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]")


class Result(NamedTuple):
    """Result of one fuzz case."""

    seed: int
    target: str
    problem: str
    """Kind of problem: `traceback`, `hang`, `memory`, `control character`, `process` (left behind) or ""."""
    detail: str
    seconds: float
    """Processor time of the case, s."""
    grown_MB: float
    """Peak resident size minus the size before the case, MB."""


def run(seed: int, stock: Stock, only: str | None = None) -> Result:
    """Run the fuzz case of a seed in a new folder, which stays if the case shows a problem."""
    rng = Random(seed)  # noqa: S311 - no secret
    drawn = rng.choices(list(TARGETS), [weight for _, weight in TARGETS.values()])[0]
    target = only or drawn
    folder = stock.folder / str(seed)
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    with contextlib.suppress(OSError):
        _CLEAR.write_text("5")  # the peak begins anew
    before, family = peak_MB(), children()
    begun, problem, detail = time.process_time(), "", ""
    with warnings.catch_warnings():
        try:
            warnings.simplefilter("error", RuntimeWarning)  # who reads a command's lines would see it
            said = TARGETS[target][0](stock, rng, folder)
        except HilError:
            said = ""  # what the command line shows of it is looked at where it is run
        except Exception as error:  # noqa: BLE001 - that is what is looked for
            said, problem = "", "traceback"
            where = traceback.extract_tb(error.__traceback__)[-1]
            detail = f"{type(error).__name__}: {error} ({where.filename}:{where.lineno})"
    seconds, grown = time.process_time() - begun, peak_MB() - before
    if problem:
        pass
    elif found := _CONTROL.search(said):
        problem, detail = "control character", said[max(found.start() - 60, 0) : found.end() + 20]
    elif seconds > LONGEST_S:
        problem = "hang"
    elif grown > MOST_MB:
        problem = "memory"
    elif left := children() - family:
        problem, detail = "process", f"left behind: {', '.join(map(str, sorted(left)))}"
    else:
        shutil.rmtree(folder)
    return Result(seed, target, problem, detail, seconds, grown)


def children() -> set[int]:
    """Process ids of all children of this process that have not been waited for."""
    found: set[int] = set()
    for task in _TASKS.glob("*/children"):
        with contextlib.suppress(OSError):  # a thread that has just ended
            found |= set(map(int, task.read_text().split()))
    return found


def peak_MB() -> float:
    """Largest resident size of this process since the case began, MB; 0 if unknown."""
    try:
        found = re.search(r"VmHWM:\s+(\d+) kB", _STATUS.read_text())
    except OSError:
        return 0.0
    return 0.0 if found is None else int(found[1]) * 1024e-6
