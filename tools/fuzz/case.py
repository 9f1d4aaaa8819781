"""One fuzz case: an input is damaged according to its seed and read; time, memory, output are checked."""

from __future__ import annotations

import re
import resource
import shutil
import time
import traceback
import warnings
from random import Random
from typing import NamedTuple

from drivers.errors import HilError
from tools.fuzz.targets import TARGETS, Stock

LONGEST_S = 5.0
"""Limit of a case's processor time: other processes may use the machine."""
MOST_MB = 250
"""Limit of the memory of a case; the first call of a command takes about as much."""
_CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]")


class Result(NamedTuple):
    """Result of one fuzz case."""

    seed: int
    target: str
    problem: str
    """Kind of problem: `traceback`, `hang`, `memory`, `control character` or ""."""
    detail: str
    seconds: float
    """Processor time of the case, s."""
    grown_MB: float
    """Growth of the largest resident size of this process, MB."""


def run(seed: int, stock: Stock, only: str | None = None) -> Result:
    """Run the fuzz case of a seed in a new folder, which stays if the case shows a problem."""
    rng = Random(seed)  # noqa: S311 - no secret
    drawn = rng.choices(list(TARGETS), [weight for _, weight in TARGETS.values()])[0]
    target = only or drawn
    folder = stock.folder / str(seed)
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    before, begun, problem, detail = peak_MB(), time.process_time(), "", ""
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
    if not problem and (found := _CONTROL.search(said)):
        problem, detail = "control character", said[max(found.start() - 60, 0) : found.end() + 20]
    elif not problem and seconds > LONGEST_S:
        problem = "hang"
    elif not problem and grown > MOST_MB:
        problem = "memory"
    if not problem:
        shutil.rmtree(folder)
    return Result(seed, target, problem, detail, seconds, grown)


def peak_MB() -> float:
    """Largest resident size of this process so far, MB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
