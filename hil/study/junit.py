"""Writes JUnit XML reports, for CI servers, of commands that check many cases."""

from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree as ET

from hil.app.files import Kind, new_file, write_whole


class Verdict(NamedTuple):
    """Result of one test case in a JUnit report."""

    group: str
    name: str
    failure: str | None = None
    """Cause of the failure, one line; None: passed."""
    detail: str = ""
    """Details of the failure."""
    output: str = ""
    """Output of the case, passed or failed."""
    wall_s: float | None = None


def check_junit_path(path: Path) -> None:
    """Check before a run that its JUnit report can be written, over an earlier one. Raises LogError."""
    report = Kind("a JUnit report", lambda there: b"<testsuite" in there.read_bytes()[:1000])
    new_file(path, option="--junit", own=report)


def write_junit(path: Path, name: str, cases: Iterable[Verdict], wall_s: float | None = None) -> None:
    """Write test cases as one suite of a JUnit report. Raises OSError if the file cannot be written."""
    suite = ET.Element("testsuite", name=_plain(name))
    for case in cases:
        entry = ET.SubElement(suite, "testcase", classname=_plain(case.group), name=_plain(case.name))
        if case.wall_s is not None:
            entry.set("time", f"{case.wall_s:.3f}")
        if case.failure is not None:
            ET.SubElement(entry, "failure", message=_plain(case.failure)).text = _plain(case.detail)
        if case.output:
            ET.SubElement(entry, "system-out").text = _plain(case.output)
    suite.attrib |= {"tests": str(len(suite)), "failures": str(len(suite.findall("*/failure")))}
    if wall_s is not None:
        suite.set("time", f"{wall_s:.3f}")
    ET.indent(suite)
    write_whole(path, f"{ET.tostring(suite, 'unicode')}\n")


def _plain(text: str) -> str:
    """Replace characters that XML 1.0 does not allow with spaces."""
    return "".join(c if c.isprintable() or c == "\n" else " " for c in text)
