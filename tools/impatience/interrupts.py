"""Ctrl-C at moments from the start of a command to its end, and a second one soon after."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from tools.impatience.child import HIL, Outcome, perform
from tools.impatience.judge import found_wrong

INTERRUPTED = 130
SECOND_S = 0.3
"""From the first to the second Ctrl-C."""


class Interrupted(NamedTuple):
    """A command that is interrupted."""

    words: tuple[str, ...]
    codes: frozenset[int]
    """How it may end, beside success: by its state, an interrupt is a wish that it fulfils."""
    needs_log: bool = False


_ONLY = frozenset({0, INTERRUPTED, -2})
"""-2: Ctrl-C while the interpreter is being started."""
COMMANDS = {
    "sim": Interrupted(("sim", "--duration", "2", "--log", "new.mcap", "--json", "new.json"), _ONLY),
    "run": Interrupted(
        ("run", "--plant", "--arm", "--duration", "1", "--log", "new.mcap", "--json", "new.json"),
        _ONLY | {1},  # a second one is an emergency stop
    ),
    "compare": Interrupted(
        ("compare", "--laws", "pd,inverse_dynamics", "--duration", "0.3", "--picture", "new.png"), _ONLY
    ),
    "replay": Interrupted(("replay", "stock.mcap", "--json", "new.json"), _ONLY, needs_log=True),
    "report": Interrupted(("report", "stock.mcap", "--out", "new.html"), _ONLY, needs_log=True),
    "plot": Interrupted(("plot", "stock.mcap", "--out", "new.png"), _ONLY, needs_log=True),
    "export": Interrupted(("export", "stock.mcap", "new.csv", "new.log"), _ONLY, needs_log=True),
    "check": Interrupted(("check",), _ONLY),
    "stability": Interrupted(("stability",), _ONLY),
    "workspace": Interrupted(("workspace", "--resolution", "40", "--picture", "new.png"), _ONLY),
    "identify": Interrupted(("identify", "virtual", "--picture", "new.png"), _ONLY),
    "design": Interrupted(("design", "hinf", "virtual", "-o", "new.yaml"), _ONLY),
    "plant": Interrupted(("plant", "--duration", "1", "--log", "new.mcap"), _ONLY),
    "faults": Interrupted(("faults", "--only", "brake_*/TRACKING"), _ONLY),
}
BROAD = ("sim", "run", "compare", "replay")
"""The commands that are interrupted at every moment; the others at a few."""


class Moment(NamedTuple):
    """One interrupted command."""

    command: str
    moments_s: tuple[float, ...]
    outcome: Outcome
    wrong: list[str]


def interrupted(command: str, stock: Path, scratch: Path, moments: int) -> Iterator[Moment]:
    """Yield a command's ends: first its own, then with interrupts at `moments` moments spread over it.

    Every third of them is followed by a second one. The start of the interpreter itself, before any line of
    ours, is left out: an interrupt there is answered by Python.
    """
    case = COMMANDS[command]
    own = _perform(case, stock, scratch / f"{command}-0", ())
    wrong = found_wrong(own, scratch / f"{command}-0", {0})
    yield Moment(command, (), own, wrong)
    ours_s = 2.0 * max(perform((sys.executable, "-c", "pass"), scratch).wall_s for _ in range(3))
    for n in range(moments):
        first_s = ours_s + (own.wall_s - ours_s) * (n + 0.5) / moments
        moments_s = (first_s, first_s + SECOND_S) if n % 3 == 2 else (first_s,)
        folder = scratch / f"{command}-{n + 1}"
        outcome = _perform(case, stock, folder, moments_s)
        early = outcome.code == -2
        wrong = found_wrong(outcome, folder, case.codes, speaks=not early)
        yield Moment(command, moments_s, outcome, wrong)


def _perform(case: Interrupted, stock: Path, folder: Path, moments_s: tuple[float, ...]) -> Outcome:
    folder.mkdir(parents=True)
    if case.needs_log:
        (folder / "stock.mcap").hardlink_to(stock)
    return perform((*HIL, *case.words), folder, moments_s)
