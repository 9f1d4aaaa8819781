"""`python -m tools.impatience`: what was interrupted, what was said, what was left behind."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import click

from tools.impatience.child import HIL, Outcome, perform
from tools.impatience.interrupts import BROAD, COMMANDS, interrupted

_FEW = 4
_SHOWN = 100


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.option("--only", multiple=True, type=click.Choice(list(COMMANDS)), help="Only these.")
@click.option(
    "--moments", type=click.IntRange(min=1), default=40, show_default=True,
    help="Of each of sim, run, compare, replay; of the others a tenth.",
)  # fmt: skip
def main(only: tuple[str, ...], moments: int) -> None:
    """Interrupt every command at many moments.

    One line a case: exit code, time to the end, last line said. Exit code 1 where a case left a traceback, a
    process, half a file or silence, or ended with a code that it may not have.
    """
    bad = 0
    with tempfile.TemporaryDirectory(prefix="hil-impatience-") as name:
        scratch = Path(name)
        for title, outcome, wrong in _cases(only, moments, scratch):
            bad += bool(wrong)
            print(_line(title, outcome))
            for each in wrong:
                print(f"    WRONG: {each}")
            sys.stdout.flush()
    print(f"{bad} cases are wrong" if bad else "no case is wrong")
    sys.exit(1 if bad else 0)


def _cases(only: tuple[str, ...], moments: int, scratch: Path) -> Iterator[tuple[str, Outcome, list[str]]]:
    stock = scratch / "stock.mcap"
    perform((*HIL, "sim", "--duration", "1", "--log", str(stock)), scratch)
    for command in COMMANDS:
        if not only or command in only:
            count = moments if command in BROAD else max(_FEW, moments // 10)
            for case in interrupted(command, stock, scratch, count):
                at = " and ".join(f"{s:.2f} s" for s in case.moments_s) or "never"
                yield f"{command} interrupted: {at}", case.outcome, case.wrong


def _line(title: str, outcome: Outcome) -> str:
    lines = [line.strip() for line in (outcome.out + outcome.err).splitlines() if line.strip()]
    said = next((line for line in reversed(lines) if line.startswith("hil:")), lines[-1] if lines else "")
    return f"{title:44s} {outcome.code:4d} {outcome.end_s:6.2f} s  {said[:_SHOWN]}"


if __name__ == "__main__":
    main()
