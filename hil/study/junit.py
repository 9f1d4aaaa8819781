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
    report = Kind("a JUnit report", lambda there: b"<testsuite" in there.read_bytes()[:1000])
    new_file(path, option="--junit", own=report)


def write_junit(path: Path, name: str, cases: Iterable[Verdict], wall_s: float | None = None) -> None:
    """Write cases as one suite. Raises LogError if the file cannot be written."""
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
    try:
        write_whole(path, f"{ET.tostring(suite, 'unicode')}\n")
    except OSError as error:
        raise LogError(f"--junit {path}: cannot be written: {error.strerror}") from None


def _plain(text: str) -> str:
    """Return a text without the characters that XML 1.0 cannot have."""
    return "".join(sign if sign.isprintable() or sign == "\n" else " " for sign in text)
