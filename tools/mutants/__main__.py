"""`make mutants`: puts one mistake at a time into a copy of the project; runs tests until one fails."""

from __future__ import annotations

import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import time
from contextlib import suppress
from hashlib import sha256
from pathlib import Path

import click

from drivers.compiled.cache import CACHE_FOLDER
from tools.mutants.mutant import Mutant, equivalents, mutants

ROOT = Path(__file__).resolve().parents[2]
AREAS = {
    "safety": ("hil/safety",),
    "cycle": ("hil/loop", "hil/operate"),
    "motion": ("hil/trajectory",),
    "drivers": ("drivers",),
    "plant_fmu": ("plant_fmu",),
    "record": ("hil/record",),
    "core": ("hil/robot", "hil/control", "hil/mathematics", "hil/estimation"),
    "design": ("hil/design", "hil/proof"),
    "lab": ("hil/lab",),
    "study": ("hil/study",),
    "app": ("hil/app", "hil/cli"),
}
"""Name of an area -> folders of its sources. Its tests are the files that import one of them; if there is a
test folder of that name, only those there."""
WHOLE = (
    "tests/golden/",
    "tests/hil/test_safety_mutation",
    "tests/loop/test_lockstep",
    "tests/replay/test_portability",
)
"""Tests that compare whole logs or sources: a failure there says nothing about a single claim."""
BUILD = ROOT / "build" / "mutants"
QUICK = "not long and not realtime and not vcan"
"""Selects tests that need neither an idle machine nor a kernel module."""
MORE_S = 300.0
"""Time that a run of tests may take beyond three times that of the unchanged tree: kernels compile again."""
_COPIED = shutil.ignore_patterns(".*", "build", "dist", "runs", "__pycache__")


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.option("--area", "areas", type=click.Choice(list(AREAS)), multiple=True, help="May be repeated.")
@click.option("--seed", type=int, default=1, show_default=True, help="Seed of the sample.")
@click.option("--sample", type=int, default=50, show_default=True, help="Number of mutants per area.")
def main(areas: tuple[str, ...], seed: int, sample: int) -> None:
    """Put mistakes into a copy of the tree, one at a time; print the test that detects each.

    A run continues where the last one ended. Results are in build/mutants, one file per area and seed.
    """
    for area in areas or AREAS:
        path = BUILD / f"{area}-{seed}.jsonl"
        before = [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []
        done = {r["key"]: r for r in before}
        drawn = sampled(area, seed, sample)
        copy = Copy(BUILD / area, own_tests(area)) if any(key not in done for key, _ in drawn) else None
        for k, (key, mutant) in enumerate(drawn, 1):
            if copy is not None and key not in done:
                outcome, by = copy.judged(mutant)
                done[key] = {"key": key, **vars(mutant), "outcome": outcome, "by": by}
                with path.open("a", encoding="utf-8") as file:
                    print(json.dumps(done[key]), file=file)
                print(f"{k}/{len(drawn)} {outcome} {mutant} {by}", file=sys.stderr, flush=True)
        outcomes = [done[key]["outcome"] for key, _ in drawn]
        count = len(drawn) - outcomes.count("not loaded")
        print(f"{area}: {outcomes.count('noticed')} of {count} noticed", flush=True)
        for (_, mutant), outcome in zip(drawn, outcomes, strict=True):
            if outcome == "survived":
                print(f"  {mutant}", flush=True)


def sources_of(area: str) -> list[str]:
    """Source files of an area, sorted by name."""
    found = (path for folder in AREAS[area] for path in (ROOT / folder).rglob("*.py"))
    return sorted(path.relative_to(ROOT).as_posix() for path in found)


def own_tests(area: str) -> list[str]:
    """Test files that import a module of an area, sorted by name."""
    rooms = "|".join(folder.replace("/", r"\.") for folder in AREAS[area])
    imports, own = re.compile(rf"^(from|import) ({rooms})\b", re.MULTILINE), ROOT / "tests" / area
    files = sorted((own if own.exists() else ROOT / "tests").rglob("test_*.py"))
    found = [path.relative_to(ROOT).as_posix() for path in files if imports.search(path.read_text("utf-8"))]
    return [name for name in found if not name.startswith(WHOLE)]


def sampled(area: str, seed: int, count: int) -> list[tuple[str, Mutant]]:
    """Draw `count` mutants with their keys, at most one per place, without those listed as equivalent.

    A place is drawn before its change: a number, which has four mutants, is as likely as a call.
    """
    equivalent = equivalents()
    places: dict[tuple[str, int, int], list[tuple[str, Mutant]]] = {}
    for file in sources_of(area):
        text = (ROOT / file).read_text(encoding="utf-8")
        for m in mutants(file, text):
            key = sha256(f"{file}\0{m.start}\0{m.end}\0{m.after}\0{text}".encode()).hexdigest()[:16]
            places.setdefault((file, m.start, m.end), []).append((key, m))
    chance = random.Random(f"{area} {seed}")  # noqa: S311 - a sample, no secret
    order = list(places.values())
    chance.shuffle(order)
    drawn = (chance.choice(at_place) for at_place in order)
    return [(key, m) for key, m in drawn if m.place not in equivalent][:count]


class Copy:
    """A copy of the project in which one file at a time is changed, and the time limit of its tests."""

    def __init__(self, folder: Path, tests: list[str]) -> None:
        self.root, self.cache, self.tests = folder / "tree", folder / "cache" / CACHE_FOLDER.name, tests
        shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(CACHE_FOLDER, self.cache)
        shutil.copytree(ROOT, self.root, ignore=_COPIED)
        begun = time.monotonic()
        code, output = self.run(tests, 3600.0)
        if code != 0:
            raise SystemExit(f"the tests fail in an unchanged copy of the tree:\n{output}")
        self.limit_s = 3 * (time.monotonic() - begun) + MORE_S

    def judged(self, mutant: Mutant) -> tuple[str, str]:
        """Run the tests on a mutant; return `noticed`, `survived` or `not loaded`, and the failed test."""
        path, compiled = self.root / mutant.file, set(self.cache.iterdir())
        text = path.read_text(encoding="utf-8")
        path.write_text(mutant.applied(text), encoding="utf-8")
        try:
            code, output = self.run(self.nearest_first(mutant), self.limit_s)
        finally:
            path.write_text(text, encoding="utf-8")
            for kernels in set(self.cache.iterdir()) - compiled:
                shutil.rmtree(kernels)
        if failed := re.search(r"^FAILED (\S+)|^ERROR (\S+::\S+)", output, re.MULTILINE):
            return "noticed", failed[1] or failed[2]
        if code is None or code < 0:
            return "noticed", "time limit or signal"
        return ("survived", "") if code == 0 else ("not loaded", "")

    def nearest_first(self, mutant: Mutant) -> list[str]:
        """Tests, those first that mention the module of the mutant."""
        module = re.compile(rf"\b{Path(mutant.file).stem}\b")
        return sorted(self.tests, key=lambda test: not module.search((self.root / test).read_text("utf-8")))

    def run(self, tests: list[str], limit_s: float) -> tuple[int | None, str]:
        """Run tests up to the first failure; return exit code, None after the time limit, and output."""
        command = [sys.executable, "-m", "pytest", "-qx", "-n0", "--tb=no", "-p", "no:cacheprovider"]
        output = self.root.parent / "output.txt"
        with output.open("w", encoding="utf-8") as file:
            process = subprocess.Popen(
                [*command, "-m", QUICK, *tests],
                cwd=self.root,
                env=os.environ | {"PYTHONPATH": str(self.root), "XDG_CACHE_HOME": str(self.cache.parent)},
                stdin=subprocess.DEVNULL,
                stdout=file,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
            code: int | None = None
            try:
                with suppress(subprocess.TimeoutExpired):
                    code = process.wait(limit_s)
            finally:  # what a test started goes with it
                with suppress(ProcessLookupError):
                    os.killpg(process.pid, signal.SIGKILL)
                process.wait()
        return code, output.read_text(encoding="utf-8", errors="replace")


if __name__ == "__main__":
    main()
