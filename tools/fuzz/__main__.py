"""`make fuzz`: cases one after the other, from a seed on, in a process that may hang or die."""

from __future__ import annotations

import json
import queue
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from pathlib import Path
from typing import IO

import click

from tools.fuzz import case
from tools.fuzz.targets import TARGETS, stock

_START_S = 300.0
"""The first case waits for what has to be compiled."""
_GRACE_S = 10.0


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.option("--seconds", type=float, default=600.0, show_default=True, help="How long.")
@click.option(
    "--seed", type=int, default=1, show_default=True, help="First seed; each case has the next one."
)
@click.option("--cases", type=int, help="Stop after so many.")
@click.option("--only", type=click.Choice(list(TARGETS)), help="Only this kind of input.")
@click.option("--work", is_flag=True, hidden=True, help="Be the process that runs the cases.")
@click.option("--stock", "folder", hidden=True, help="Where the sound inputs are.")
def main(
    seconds: float, seed: int, cases: int | None, only: str | None, work: bool, folder: str | None
) -> None:
    """Fuzz everything that a stranger may hand in; print what was found.

    Exit code 1 where there is a traceback, a case of more than 5 s, one that takes 250 MB more than before,
    a control character in a message, or a process that is left behind. `--seed N --cases 1` runs one case
    again.
    """
    if work:
        assert folder is not None
        _work(seed, Path(folder), only)
        return
    with tempfile.TemporaryDirectory(prefix="hil-fuzz-stock-") as made:
        last, results = _supervise(seconds, seed, cases, only, Path(made))
    sys.exit(_report(seed, last, results))


def _work(seed: int, folder: Path, only: str | None) -> None:
    """Run cases for ever; announce each, then print its result."""
    sound = stock(folder)
    while True:
        print(json.dumps([seed]), flush=True)
        print(json.dumps(case.run(seed, sound, only)), flush=True)
        seed += 1


class _Worker:
    """A process that runs cases, and the thread that reads what it prints."""

    def __init__(self, seed: int, folder: Path, only: str | None) -> None:
        command = [sys.executable, "-m", "tools.fuzz", "--work", "--seed", str(seed), "--stock", str(folder)]
        self.process = subprocess.Popen(
            [*command, *(("--only", only) if only else ())],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        )
        assert self.process.stdout is not None
        self.lines: queue.Queue[str] = queue.Queue()
        threading.Thread(target=self._read, args=(self.process.stdout,), daemon=True).start()

    def _read(self, stream: IO[str]) -> None:
        for line in stream:
            self.lines.put(line)
        self.lines.put("")

    def end(self) -> None:
        self.process.kill()
        self.process.wait()


def _supervise(
    seconds: float, seed: int, cases: int | None, only: str | None, folder: Path
) -> tuple[int, list[case.Result]]:
    """Run cases until the time is over; return the next seed and the results."""
    results: list[case.Result] = []
    until = time.monotonic() + seconds
    worker, patience = _Worker(seed, folder, only), _START_S
    begun, now_at = time.monotonic(), seed
    while time.monotonic() < until and (cases is None or len(results) < cases):
        try:
            line = worker.lines.get(timeout=patience)
        except queue.Empty:
            line = ""
        if not line:
            died = worker.process.poll() is not None
            problem = f"died: {worker.process.returncode}" if died else "hang"
            target, _ = case.kind_of(now_at, only)
            results.append(case.Result(now_at, target, problem, "", time.monotonic() - begun, 0.0))
            _tell(results[-1])
            worker.end()
            now_at += 1
            worker, patience = _Worker(now_at, folder, only), _START_S
            continue
        fields = json.loads(line)
        if len(fields) == 1:
            (now_at,), begun, patience = fields, time.monotonic(), case.LONGEST_S + _GRACE_S
            continue
        results.append(case.Result(*fields))
        now_at += 1
        if results[-1].problem:
            _tell(results[-1])
    worker.end()
    return now_at, results


def _tell(result: case.Result) -> None:
    text = f"seed {result.seed}: {result.target}: {result.problem} {result.detail!r}"
    print(f"{text[:400]} {result.seconds:.1f} s, {result.grown_MB:.0f} MB", flush=True)


def _report(seed: int, last: int, results: list[case.Result]) -> int:
    for name in TARGETS:
        mine = [r for r in results if r.target == name]
        found = Counter(r.problem.partition(":")[0] for r in mine if r.problem)
        if mine:
            slowest, largest = max(r.seconds for r in mine), max(r.grown_MB for r in mine)
            print(
                f"{name:14} {len(mine):6} cases, {found['traceback']} tracebacks, {found['hang']} hangs, "
                f"{sum(found.values()) - found['traceback'] - found['hang']} others; "
                f"longest {slowest:.1f} s, grown by {largest:.0f} MB"
            )
    wrong = sum(bool(r.problem) for r in results)
    print(f"{len(results)} cases from seed {seed}, {wrong} with a finding; go on with --seed {last}")
    return 1 if wrong or not results else 0


if __name__ == "__main__":
    main()
