"""`make fuzz`: runs fuzz cases one after the other, each with the next seed."""

from __future__ import annotations

import faulthandler
import shutil
import sys
import tempfile
import time
from pathlib import Path

import click

from tools.fuzz import case
from tools.fuzz.targets import TARGETS, stock

_HANGS_S = 300.0
"""A longer case ends the program; the first case includes the time for compilation."""


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
    sound, found, until = stock(folder), list[case.Result](), time.monotonic() + seconds
    while time.monotonic() < until and len(found) != cases:
        faulthandler.dump_traceback_later(_HANGS_S, exit=True)
        result = case.run(seed + len(found), sound, only)
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


def _report(results: list[case.Result]) -> int:
    """Print one line about each kind of input; return the number of cases with a problem."""
    for name in TARGETS:
        mine = [r for r in results if r.target == name]
        if mine:
            slowest, largest = max(r.seconds for r in mine), max(r.grown_MB for r in mine)
            print(f"{name:14} {len(mine):6} cases, longest {slowest:.1f} s, grown by {largest:.0f} MB")
    return sum(bool(r.problem) for r in results)


if __name__ == "__main__":
    main()
