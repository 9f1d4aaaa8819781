"""The table of results: JSON lines that a later run goes on with, and what they say."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass
from pathlib import Path

_SHOWN = 70
"""Characters of a change that the summary shows; the table has all."""


@dataclass(frozen=True)
class Result:
    """One mutant and what became of it.

    `outcome` is ``noticed``, ``survived`` or ``not loaded``: the module does not even import, which is no
    mistake that a test has to notice.
    """

    key: str
    file: str
    line: int
    where: str
    statement: str
    operator: str
    before: str
    after: str
    outcome: str
    by: str
    tests: int
    seconds: float


def read(path: Path) -> dict[str, Result]:
    """Return the results so far, by key; the last line of a key holds. A line cut short is left out."""
    found: dict[str, Result] = {}
    if path.exists():
        for line in path.read_text(encoding="utf-8").splitlines():
            try:
                result = Result(**json.loads(line))
            except (json.JSONDecodeError, TypeError):
                continue
            found[result.key] = result
    return found


def append(path: Path, result: Result) -> None:
    """Write one line, below one that a killed run may have cut short."""
    path.parent.mkdir(parents=True, exist_ok=True)
    cut = path.exists() and not path.read_bytes().endswith(b"\n")
    with path.open("a", encoding="utf-8") as file:
        print("\n" if cut else "", end="", file=file)
        print(json.dumps(asdict(result)), file=file)


def wilson(hits: int, count: int, z: float = 1.959964) -> tuple[float, float]:
    """Return the 95 % interval of a share (Wilson, J. Am. Stat. Assoc. 22, 1927, 209-212)."""
    if count == 0:
        return 0.0, 1.0
    p, square = hits / count, z * z / count
    middle = (p + square / 2) / (1 + square)
    half = z * math.sqrt(p * (1 - p) / count + square / (4 * count)) / (1 + square)
    return middle - half, middle + half


def summary(area: str, results: list[Result], equivalent: int) -> str:
    """Return the share noticed, its interval, and every survivor."""
    counted = [r for r in results if r.outcome != "not loaded"]
    left = [r for r in counted if r.outcome == "survived"]
    hits = len(counted) - len(left)
    low, high = wilson(hits, len(counted))
    share = f"{hits} of {len(counted)} noticed"
    if counted:
        share += f", {100 * hits / len(counted):.0f} % (95 %: {100 * low:.0f} to {100 * high:.0f} %)"
    aside = f"; {len(results) - len(counted)} did not load, {equivalent} equivalent"
    lines = [
        f"  {r.file}:{r.line} {r.where}: {_short(r.before)} -> {_short(r.after)} ({r.operator})" for r in left
    ]
    return "\n".join([f"{area}: {share}{aside}", *lines])


def _short(text: str) -> str:
    return repr(text if len(text) <= _SHOWN else f"{text[: _SHOWN - 4]} ...")
