"""Measure the figures that README and docs state, listed in docs/claims.yaml, for `make claims`.

Each run is a command that writes JSON (`--json`); each claim quotes a text of a page and reads its figures
out of one run. A figure holds if the measured value, rounded to the quoted digits, is the quoted one.
"""

from __future__ import annotations

import json
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np
import yaml

from hil.app.configuration.changes import with_changes
from hil.app.configuration.configuration import load

ROOT = Path(__file__).resolve().parents[1]
FILE = ROOT / "docs/claims.yaml"
FIGURE = re.compile(r"\{([\d.]+)\}")
BENCH = "make bench"
"""Run that is not performed here: its figures depend on the machine."""


class Claim(NamedTuple):
    """Figures in a text of a page."""

    page: str
    text: str
    """Each figure in braces."""
    run: str
    read: list[str] = []
    """Where the figures are in the JSON of the run: `FACTOR * a/b/c`; of a list the largest magnitude."""
    within: float = 0.0
    """Relative tolerance in addition to rounding, for figures that depend on machine or noise."""

    @property
    def quote(self) -> str:
        """The text as it stands on the page."""
        return FIGURE.sub(r"\1", self.text)

    @property
    def figures(self) -> list[str]:
        """The quoted figures."""
        return FIGURE.findall(self.text)

    def stands(self) -> bool:
        """True if the page has the text; line breaks do not count."""
        return " ".join(self.quote.split()) in " ".join((ROOT / self.page).read_text("utf-8").split())


class Run(NamedTuple):
    """A command whose third word is a configuration, where `changes` applies to one."""

    command: str
    changes: Mapping[str, Any] = {}

    def result(self) -> Any:
        """JSON that the command writes. Raises CalledProcessError if it writes none."""
        words = [str(ROOT / word) if (ROOT / word).is_file() else word for word in shlex.split(self.command)]
        with TemporaryDirectory() as folder:
            there = Path(folder)
            if self.changes:
                (there / "claims.yaml").write_text(with_changes(load(words[2]).text, self.changes))
                words[2] = "claims.yaml"
            program = [sys.executable, "-m", "hil.cli"] if words[0] == "hil" else [sys.executable]
            command = [*program, *words[1:], "--json", "result.json"]
            paths = os.environ | {"PYTHONPATH": str(ROOT)}
            done = subprocess.run(command, cwd=there, env=paths, capture_output=True, text=True, check=False)
            if not (there / "result.json").exists():
                raise subprocess.CalledProcessError(done.returncode, command, done.stdout, done.stderr)
            return json.loads((there / "result.json").read_text())


def table() -> tuple[dict[str, Run], list[Claim]]:
    """Runs and claims of docs/claims.yaml. Raises KeyError: a claim with an unknown run."""
    found = yaml.safe_load(FILE.read_text("utf-8"))
    runs = {name: Run(**run) for name, run in found["runs"].items()}
    claims = [Claim(**claim) for claim in found["claims"]]
    for claim in claims:
        if claim.run not in runs or len(claim.read) != len(claim.figures):
            raise KeyError(f"{claim.page}: {claim.quote}: run {claim.run}, {len(claim.read)} places to read")
    return runs, claims


def value(result: Any, place: str) -> float:
    """Figure at a place of a run's JSON; of a list the largest magnitude."""
    *factor, path = place.split(" * ")
    for key in path.split("/"):
        result = result[int(key)] if isinstance(result, list) else result[key]
    return float(np.max(np.abs(result))) * float(factor[0] if factor else 1.0)


def holds(quoted: str, measured: float, within: float = 0.0) -> bool:
    """True if a quoted figure is the measured one, rounded, or within the relative tolerance of it."""
    digits = len(quoted.partition(".")[2])
    return abs(float(quoted) - measured) <= 0.5000001 * 10.0**-digits + within * abs(measured)


def judged(claims: list[Claim], result: Any) -> Iterator[tuple[Claim, str, float, bool]]:
    """Yield each figure of the claims with the measured value and the verdict."""
    for claim in claims:
        for quoted, place in zip(claim.figures, claim.read, strict=True):
            measured = value(result, place)
            yield claim, quoted, measured, holds(quoted, measured, claim.within)
