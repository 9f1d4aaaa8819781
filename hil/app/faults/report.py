"""The matrix as a table and as JUnit XML."""

from collections import Counter
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

from rich.table import Table
from rich.text import Text

from drivers.errors import LogError
from hil.app.files import write_whole
from hil.app.output import print_table


def show(summary: dict[str, Any]) -> None:
    """Print one line a case."""
    table = Table(box=None, pad_edge=False, header_style="bold")
    for title in ("fault", "when", "leg and size", "reaction"):
        table.add_column(title, overflow="fold")
    table.add_column("fault after ms", justify="right")
    table.add_column("motion mm", justify="right")
    table.add_column("verdict", overflow="fold")
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


def check_junit_path(path: Path) -> None:
    """Refuse a file that could not be written in the end. Raises LogError."""
    where = f"--junit {path}"
    if not path.parent.is_dir():
        raise LogError(f"{where}: there is no folder {path.parent}; make it first")
    if path.is_dir():
        raise LogError(f"{where}: is a folder; name a file")
    if path.exists() and b"<testsuite" not in path.read_bytes()[:1000]:
        raise LogError(f"{where}: exists, is no JUnit report and is not overwritten; name another file")


def write_junit(path: Path, summary: dict[str, Any]) -> None:
    """Write the matrix as JUnit XML. Raises LogError if the file cannot be written."""
    suite = ET.Element(
        "testsuite",
        name=f"hil faults {summary['configuration']}",
        tests=str(summary["cases"]),
        failures=str(summary["failed"]),
        time=f"{summary['wall_s']:.3f}",
    )
    places = Counter((case["kind"], case["when"]) for case in summary["matrix"])
    for case in summary["matrix"]:
        alone = places[case["kind"], case["when"]] == 1
        name = case["when"] if alone else f"{case['when']} {case['given']}"
        entry = ET.SubElement(
            suite, "testcase", classname=case["kind"], name=name, time=f"{case['wall_s']:.3f}"
        )
        if not case["success"]:
            failure = ET.SubElement(entry, "failure", message=case["verdict"])
            failure.text = f"{case['fault']}: {reaction(case)}. {case.get('reason', '')}".rstrip()
        ET.SubElement(entry, "system-out").text = case["verdict"]
    ET.indent(suite)
    text = ET.tostring(suite, encoding="unicode", xml_declaration=False)
    try:
        write_whole(path, f'<?xml version="1.0" encoding="UTF-8"?>\n{text}\n')
    except OSError as error:
        raise LogError(f"--junit {path}: cannot be written: {error.strerror}") from None
