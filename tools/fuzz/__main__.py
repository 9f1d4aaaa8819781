"""`make fuzz`: fuzz cases one after the other; each damages an input according to its seed, and reads it."""

from __future__ import annotations

import faulthandler
import re
import resource
import shutil
import sys
import tempfile
import time
import traceback
import warnings
from pathlib import Path
from random import Random
from typing import NamedTuple

import click

from drivers.errors import HilError
from tools.fuzz.targets import TARGETS, stock

LONGEST_S = 5.0
"""Limit of a case's processor time: other processes may use the machine."""
_HANGS_S = 300.0
"""A longer case ends the program; the first case includes the time for compilation."""
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


def run(seed: int, sound: Path, only: str | None = None) -> Result:
    """Run the fuzz case of a seed in a new folder below `sound`, which stays if the case shows a problem."""
    rng = Random(seed)  # noqa: S311 - no secret
    drawn = rng.choices(list(TARGETS), [weight for _, weight in TARGETS.values()])[0]
    target = only or drawn
    folder = sound / str(seed)
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    before, begun, problem, detail = peak_MB(), time.process_time(), "", ""
    with warnings.catch_warnings():
        try:
            warnings.simplefilter("error", RuntimeWarning)  # who reads a command's lines would see it
            said = TARGETS[target][0](rng, folder)
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


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.option("--seconds", type=float, default=600.0, show_default=True, help="Duration in seconds.")
@click.option("--seed", default=1, show_default=True, help="First seed; each case has the next one.")
@click.option("--cases", type=int, help="Stop after this number of cases.")
@click.option("--only", type=click.Choice(list(TARGETS)), help="Run only this kind of input.")
def main(seconds: float, seed: int, cases: int | None, only: str | None) -> None:
    """Fuzz all untrusted input; print the findings, and where their inputs are.

    Exit code 1 on a traceback, a case of more than 5 s, one that takes 250 MB more than before, or a control
    character in a message. A crash of the interpreter, or a case
    that hangs, ends the program with the stack; its input is in the folder of the last seed.
    `--seed N --cases 1` runs one case again.
    """
    folder = Path(tempfile.mkdtemp(prefix="hil-fuzz-"))
    print(f"inputs, by seed: {folder}", flush=True)
    faulthandler.enable()
    sound, found, until = stock(folder), list[Result](), time.monotonic() + seconds
    while time.monotonic() < until and len(found) != cases:
        faulthandler.dump_traceback_later(_HANGS_S, exit=True)
        result = run(seed + len(found), sound, only)
        found.append(result)
        if result.problem:
            text = f"seed {result.seed}: {result.target}: {result.problem} {result.detail!r}"
            print(f"{text[:400]} {result.seconds:.1f} s, {result.grown_MB:.0f} MB", flush=True)
    faulthandler.cancel_dump_traceback_later()
    wrong = _report(found)
    print(
        f"{len(found)} cases from seed {seed}, {wrong} with a finding; "
        f"continue with --seed {seed + len(found)}"
    )
    if wrong:
        sys.exit(1)
    shutil.rmtree(folder)


def _report(results: list[Result]) -> int:
    """Print one line about each kind of input; return the number of cases with a problem."""
    for name in TARGETS:
        mine = [r for r in results if r.target == name]
        if mine:
            slowest, largest = max(r.seconds for r in mine), max(r.grown_MB for r in mine)
            print(f"{name:14} {len(mine):6} cases, longest {slowest:.1f} s, grown by {largest:.0f} MB")
    return sum(bool(r.problem) for r in results)


if __name__ == "__main__":
    main()
