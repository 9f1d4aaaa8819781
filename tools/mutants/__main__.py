"""`make mutants`: sample, run, resume, report."""

from __future__ import annotations

import hashlib
import queue
import random
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import click

from tools.mutants import table
from tools.mutants.areas import AREAS, ROOT, Area
from tools.mutants.choice import Context, chosen, contexts
from tools.mutants.equivalent import equivalents, is_equivalent
from tools.mutants.mutant import Mutant, mutants
from tools.mutants.table import Result
from tools.mutants.tree import Tree

BUILD = ROOT / "build" / "mutants"
LOAD_S, START_S = 120.0, 60.0
"""Longest import, with its compilation; what a run of tests may take beyond three times its recorded time."""
COMPILE_S = 240.0
"""What a run may take beyond that where kernels compile anew."""


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.option("--area", "areas", type=click.Choice(list(AREAS)), multiple=True, help="Only this one; repeat.")
@click.option("--seed", type=int, default=1, show_default=True, help="Of the sample.")
@click.option("--sample", type=int, default=50, show_default=True, help="Mutants of each area.")
@click.option("--budget", type=float, default=60.0, show_default=True, help="Seconds of tests for a mutant.")
@click.option("--jobs", type=int, default=2, show_default=True, help="Copies of the tree, side by side.")
@click.option("--again", is_flag=True, help="Run survivors again: there are new tests.")
@click.option("--fresh", is_flag=True, help="Run all again, and record anew what each test runs.")
def main(
    areas: tuple[str, ...], seed: int, sample: int, budget: float, jobs: int, again: bool, fresh: bool
) -> None:
    """Put mistakes into a copy of the tree, one at a time; tell which test notices each.

    A run goes on where the last one ended. Results are in build/mutants, a file an area and seed.
    """
    known = equivalents(ROOT)
    trees: queue.Queue[Tree] = queue.Queue()
    for k in range(jobs):
        trees.put(Tree(BUILD / f"copy-{k}"))
    for name in areas or AREAS:
        path = BUILD / f"{name}-{seed}.jsonl"
        if fresh:
            path.unlink(missing_ok=True)
        recorded = recordings(AREAS[name], trees, fresh=fresh)
        drawn, equivalent = sampled(name, AREAS[name], seed, sample, known)
        run(drawn, recorded, trees, path, budget_s=budget, again=again)
        done = table.read(path)
        print(table.summary(name, [done[k] for k, _ in drawn if k in done], equivalent), flush=True)


def recordings(area: Area, trees: queue.Queue[Tree], *, fresh: bool) -> list[Context]:
    """Return what the area's tests run; a test file is recorded once, until its text differs."""
    folder = BUILD / "contexts"
    folder.mkdir(parents=True, exist_ok=True)
    paths = {f: folder / f"{Path(f).stem}-{_digest(ROOT / f)}.jsonl" for f in area.test_files()}

    def record(file: str) -> None:
        begun, tree = time.monotonic(), trees.get()
        unfinished = paths[file].with_suffix(".tmp")
        try:
            tree.record([file], unfinished)
        finally:
            trees.put(tree)
        unfinished.rename(paths[file])
        print(f"recorded {file} in {time.monotonic() - begun:.0f} s", file=sys.stderr, flush=True)

    with ThreadPoolExecutor(trees.qsize()) as pool:
        list(pool.map(record, [file for file, path in paths.items() if fresh or not path.exists()]))
    return contexts(paths.values())


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()[:12]


def sampled(
    name: str, area: Area, seed: int, count: int, known: dict[tuple[str, ...], str], root: Path = ROOT
) -> tuple[list[tuple[str, Mutant]], int]:
    """Draw `count` mutants, at most one a place, with keys; return how many equivalent ones were passed.

    A place is drawn before its change: a number, which can be wrong in four ways, is no likelier than a call.
    """
    places: dict[tuple[str, int, int], list[tuple[str, Mutant]]] = {}
    for file in area.source_files(root):
        text = (root / file).read_text(encoding="utf-8")
        for mutant in mutants(file, text):
            places.setdefault((file, mutant.start, mutant.end), []).append((mutant.key(text), mutant))
    chance = random.Random(f"{name} {seed}")  # noqa: S311 - a sample, no secret
    order = list(places.values())
    chance.shuffle(order)
    drawn: list[tuple[str, Mutant]] = []
    passed = 0
    for at_place in order:
        key, mutant = chance.choice(at_place)
        if len(drawn) == count:
            break
        if is_equivalent(mutant, known):
            passed += 1
        else:
            drawn.append((key, mutant))
    return drawn, passed


def run(
    drawn: list[tuple[str, Mutant]],
    recorded: list[Context],
    trees: queue.Queue[Tree],
    path: Path,
    *,
    budget_s: float,
    again: bool,
) -> None:
    """Run what the table does not have yet, and with `again` what survived; write each result at once."""
    before = table.read(path)
    todo = [
        (key, mutant)
        for key, mutant in drawn
        if key not in before or (again and before[key].outcome == "survived")
    ]

    def one(entry: tuple[str, Mutant]) -> Result:
        tree = trees.get()
        try:
            return judged(*entry, recorded, tree, budget_s)
        finally:
            trees.put(tree)

    with ThreadPoolExecutor(trees.qsize()) as pool:
        for k, result in enumerate(pool.map(one, todo), 1):
            table.append(path, result)
            told = f"{result.file}:{result.line}: {result.before!r} -> {result.after!r}"
            print(f"{k}/{len(todo)} {result.outcome} {told} {result.by}", file=sys.stderr, flush=True)


def judged(key: str, mutant: Mutant, recorded: list[Context], tree: Tree, budget_s: float) -> Result:
    """Run the tests that can notice one mutant, in the copy of the tree."""
    begun = time.monotonic()
    tests = chosen(mutant, recorded, budget_s)
    limit = START_S + 3 * sum(c.seconds for c in tests) + COMPILE_S
    text = (tree.root / mutant.file).read_text(encoding="utf-8")
    outcome, by = "survived", ""
    with tree.changed(mutant.file, mutant.applied(text)):
        if not tree.loads(mutant.file, LOAD_S + COMPILE_S):
            outcome = "not loaded"
        elif tests:
            by = tree.noticed_by([c.test for c in tests], limit)
            outcome = "noticed" if by else "survived"
    return Result(
        key=key,
        file=mutant.file,
        line=mutant.line,
        where=mutant.where,
        statement=mutant.statement,
        operator=mutant.operator,
        before=mutant.before,
        after=mutant.after,
        outcome=outcome,
        by=by,
        tests=len(tests),
        seconds=round(time.monotonic() - begun, 2),
    )


if __name__ == "__main__":
    main()
