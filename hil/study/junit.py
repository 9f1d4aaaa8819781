"""JUnit XML: what CI servers read, of a command that judges many cases."""

from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree as ET

from drivers.errors import LogError
from hil.app.files import Kind, new_file, write_whole


class Verdict(NamedTuple):
    """One case."""

    group: str
    name: str
    failure: str | None = None
    """What it failed by, in a line; None: it passed."""
    detail: str = ""
    """More of the failure."""
    output: str = ""
    """What there is to read of a case, passed or not."""
    wall_s: float | None = None


def check_junit_path(path: Path) -> None:
    """Refuse a file that could not be written in the end; an earlier report is replaced. Raises LogError."""
    new_file(path, option="--junit", own=Kind("a JUnit report", _is_report))


def _is_report(path: Path) -> bool:
    with path.open("rb") as file:
        return b"<testsuite" in file.read(1000)


def write_junit(path: Path, name: str, cases: Iterable[Verdict], wall_s: float | None = None) -> None:
    """Write cases as one suite. Raises LogError if the file cannot be written."""
    suite = ET.Element("testsuite", name=_plain(name))
    tests = failures = 0
    for case in cases:
        tests += 1
        entry = ET.SubElement(suite, "testcase", classname=_plain(case.group), name=_plain(case.name))
        if case.wall_s is not None:
            entry.set("time", f"{case.wall_s:.3f}")
        if case.failure is not None:
            failures += 1
            ET.SubElement(entry, "failure", message=_plain(case.failure)).text = _plain(case.detail)
        if case.output:
            ET.SubElement(entry, "system-out").text = _plain(case.output)
    suite.set("tests", str(tests))
    suite.set("failures", str(failures))
    if wall_s is not None:
        suite.set("time", f"{wall_s:.3f}")
    ET.indent(suite)
    text = ET.tostring(suite, encoding="unicode", xml_declaration=False)
    try:
        write_whole(path, f'<?xml version="1.0" encoding="UTF-8"?>\n{text}\n')
    except OSError as error:
        raise LogError(f"--junit {path}: cannot be written: {error.strerror}") from None


def _plain(text: str) -> str:
    """Return a text without the signs that XML 1.0 cannot have."""
    return "".join(sign if sign.isprintable() or sign == "\n" else " " for sign in text)
