"""`make fuzz`: cases one after the other, from a seed on, in a process that may hang or die."""

from __future__ import annotations

import multiprocessing
import shutil
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Generator
from contextlib import closing
from pathlib import Path

import click

from tools.fuzz import case
from tools.fuzz.targets import TARGETS

_START_S = 300.0
"""The first case of a process waits for what has to be compiled."""
_GRACE_S = 10.0


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.option("--seconds", type=float, default=600.0, show_default=True, help="How long.")
@click.option("--seed", default=1, show_default=True, help="First seed; each case has the next one.")
@click.option("--cases", type=int, help="Stop after so many.")
@click.option("--only", type=click.Choice(list(TARGETS)), help="Only this kind of input.")
def main(seconds: float, seed: int, cases: int | None, only: str | None) -> None:
    """Fuzz all untrusted input; print what was found, and where its input is.

    Exit code 1 where there is a traceback, a case of more than 5 s, one that takes 250 MB more than before,
    a control character in a message, a process that is left behind, or an interpreter that crashed.
    `--seed N --cases 1` runs one case again.
    """
    folder = Path(tempfile.mkdtemp(prefix="hil-fuzz-"))
    found: list[case.Result] = []
    until = time.monotonic() + seconds
    with closing(_results(seed, only, folder)) as results:
        for result in results:
            found.append(result)
            if result.problem:
                text = f"seed {result.seed}: {result.target}: {result.problem} {result.detail!r}"
                print(f"{text[:400]} {result.seconds:.1f} s, {result.grown_MB:.0f} MB", flush=True)
            if time.monotonic() >= until or len(found) == cases:
                break
    wrong = _report(found)
    print(
        f"{len(found)} cases from seed {seed}, {wrong} with a finding; go on with --seed {seed + len(found)}"
    )
    if wrong:
        print(f"their inputs, by seed, and what the process printed last: {folder}")
        sys.exit(1)
    shutil.rmtree(folder)


def _results(seed: int, only: str | None, folder: Path) -> Generator[case.Result, None, None]:
    """Yield case after case; a process that hangs or dies is a finding, and the next case has another one."""
    context = multiprocessing.get_context("spawn")
    while True:
        ours, theirs = context.Pipe()
        process = context.Process(target=case.serve, args=(theirs, folder, only))
        process.start()
        theirs.close()
        problem, patience = "", _START_S
        try:
            while not problem:
                begun = time.monotonic()
                try:
                    ours.send(seed)
                    found = ours.recv() if ours.poll(patience) else None
                    problem = "" if found else "hang"
                except (EOFError, OSError):
                    process.join(_GRACE_S)
                    found, problem = None, f"died: {process.exitcode}"
                target, patience = case.kind_of(seed, only)[0], case.LONGEST_S + _GRACE_S
                yield found or case.Result(seed, target, problem, "", time.monotonic() - begun, 0.0)
                seed += 1
        finally:
            process.kill()
            process.join()


def _report(results: list[case.Result]) -> int:
    """Print a line for each kind of input; return how many cases have a finding."""
    for name in TARGETS:
        mine = [r for r in results if r.target == name]
        found = Counter(r.problem.partition(":")[0] for r in mine if r.problem)
        if mine:
            kinds = "".join(f", {kind}: {count}" for kind, count in found.items())
            slowest, largest = max(r.seconds for r in mine), max(r.grown_MB for r in mine)
            print(f"{name:14} {len(mine):6} cases, longest {slowest:.1f} s, grown by {largest:.0f} MB{kinds}")
    return sum(bool(r.problem) for r in results)


if __name__ == "__main__":
    main()
