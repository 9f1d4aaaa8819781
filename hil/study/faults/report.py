"""The matrix as a table and as JUnit XML."""

from collections import Counter
from collections.abc import Iterator
from typing import Any

from hil.study.junit import Verdict
from hil.study.table import Column, print_rows


def show(summary: dict[str, Any]) -> None:
    """Print one line a case."""
    columns = (
        Column("fault", lambda case: case["kind"], left=True),
        Column("when", lambda case: case["when"], left=True),
        Column("leg and size", lambda case: case["given"], left=True),
        Column("reaction", reaction, left=True),
        Column("fault after ms", lambda case: _figure(case.get("after_ms"))),
        Column("motion mm", lambda case: _figure(case.get("motion_mm"))),
        Column(
            "verdict", lambda case: f"{'pass' if case['success'] else 'FAIL'}: {case['verdict']}", left=True
        ),
    )
    print_rows(columns, summary["matrix"], lambda case: "" if case["success"] else "red")


def reaction(case: dict[str, Any]) -> str:
    """Return in which mode a case ended, the faults named, and the legs."""
    if "ended" not in case:
        return "-"
    legs = f"leg {', '.join(map(str, case['legs']))}" if case["legs"] else ""
    return " ".join(filter(None, (case["ended"], *case["faults"], legs)))


def _figure(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}" if value < 100 else f"{value:.0f}"


def shown(summary: dict[str, Any]) -> dict[str, Any]:
    """Return the summary without the table's content."""
    return {key: value for key, value in summary.items() if key != "matrix"}


def verdicts(summary: dict[str, Any]) -> Iterator[Verdict]:
    """Yield a case of JUnit for each fault of the matrix."""
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
