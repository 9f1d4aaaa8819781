"""`hil faults CONFIG`: injects each kind of fault at each moment of a run, and checks the reactions."""

import time
from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Any

from hil.app.check.command import stopping_distances_m
from hil.app.compose import build_nodes
from hil.app.configuration.changes import unattended
from hil.app.configuration.configuration import Configuration
from hil.study.faults.case_run import Job, failed, run_case
from hil.study.faults.cases import cases
from hil.study.faults.verdict import Bounds
from hil.study.junit import Verdict
from hil.study.table import Column, figure, print_rows
from hil.study.workers import Progress, perform


def run_matrix(
    c: Configuration,
    *,
    only: Sequence[str] = (),
    legs: Sequence[int] = (),
    seed: int | None = None,
    jobs: int | None = None,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Simulate all cases, or the cases that match `only`; return the summary (key `success`: all passed).

    legs, seed : as in `cases`. jobs : number of processes; default one per processor, 1: this process. Raises
    ConfigurationError: the configuration cannot run, or a pattern matches no case; PlantError: the plant
    cannot be opened.
    """
    begun = time.perf_counter()
    c.require("sim")
    c = unattended(c)
    chosen = cases(c, only, legs, seed)
    build_nodes(c)[1].close()  # once, before each case would fail
    bounds = Bounds(*stopping_distances_m(c), c.limits.following_error_m, c.limits.following_error_s)
    order = {(case.name, case.given): n for n, case in enumerate(chosen)}
    work = [Job(case, bounds) for case in chosen]
    done = list(perform(work, run_case, failed, jobs, progress))
    done.sort(key=lambda found: order[f"{found['kind']}/{found['when']}", found["given"]])
    missed = sum(not found["success"] for found in done)
    return {
        "success": not missed,
        "kind": "faults",
        "configuration": c.source,
        "seed": seed,
        "cases": len(done),
        "failed": missed,
        "stopping_distance_mm": 1e3 * bounds.stopping_m,
        "controlled_stop_mm": 1e3 * bounds.controlled_m,
        "matrix": done,
        "wall_s": time.perf_counter() - begun,
    }


def show(summary: dict[str, Any]) -> None:
    """Print a table with one line per case: fault, moment, reaction and result."""
    columns = (
        Column("fault", lambda case: case["kind"], left=True),
        Column("when", lambda case: case["when"], left=True),
        Column("leg and size", lambda case: case["given"], left=True),
        Column("reaction", reaction, left=True),
        Column("fault after ms", lambda case: figure(case.get("after_ms"))),
        Column("motion mm", lambda case: figure(case.get("motion_mm"))),
        Column(
            "verdict", lambda case: f"{'pass' if case['success'] else 'FAIL'}: {case['verdict']}", left=True
        ),
    )
    print_rows(columns, summary["matrix"], lambda case: "" if case["success"] else "red")


def reaction(case: dict[str, Any]) -> str:
    """Text of a case's reaction: its final mode, the reported faults and their legs."""
    if "ended" not in case:
        return "-"
    legs = f"leg {', '.join(map(str, case['legs']))}" if case["legs"] else ""
    return " ".join(filter(None, (case["ended"], *case["faults"], legs)))


def shown(summary: dict[str, Any]) -> dict[str, Any]:
    """Summary of `hil faults` without the list of cases."""
    return {key: value for key, value in summary.items() if key != "matrix"}


def verdicts(summary: dict[str, Any]) -> Iterator[Verdict]:
    """Yield one JUnit test case for each case of `hil faults`."""
    places = Counter((case["kind"], case["when"]) for case in summary["matrix"])
    for case in summary["matrix"]:
        alone = places[case["kind"], case["when"]] == 1
        yield Verdict(
            group=case["kind"],
            name=case["when"] if alone else f"{case['when']} {case['given']}",
            failure=None if case["success"] else case["verdict"],
            detail=f"{case['fault']}: {reaction(case)}. {case.get('reason', '')}".rstrip(),
            output=case["verdict"],
            wall_s=case["wall_s"],
        )
