"""The matrix as a table and as JUnit XML."""

from collections import Counter
from collections.abc import Iterator
from typing import Any

from rich.text import Text

from hil.app.output import print_table
from hil.study.junit import Verdict
from hil.study.table import results


def show(summary: dict[str, Any]) -> None:
    """Print one line a case."""
    words = ("fault", "when", "leg and size", "reaction")
    table = results(*words, "fault after ms", "motion mm", "verdict", left=(*words, "verdict"))
    last = ""
    for case in summary["matrix"]:
        name = case["kind"] if case["kind"] != last else ""
        last = case["kind"]
        style = "" if case["success"] else "red"
        verdict = Text(f"{'pass' if case['success'] else 'FAIL'}: {case['verdict']}", style=style)
        figures = (_figure(case, key) for key in ("after_ms", "motion_mm"))
        table.add_row(name, case["when"], case["given"], reaction(case), *figures, verdict)
    print_table(table)


def reaction(case: dict[str, Any]) -> str:
    """Return in which mode a case ended, the faults named, and the legs."""
    if "ended" not in case:
        return "-"
    words = [case["ended"], " ".join(case["faults"])]
    if case["legs"]:
        words.append(f"leg {', '.join(map(str, case['legs']))}")
    return " ".join(filter(None, words))


def _figure(case: dict[str, Any], key: str) -> str:
    value = case.get(key)
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
