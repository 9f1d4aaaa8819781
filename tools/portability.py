"""`make portability`: all tests with several Pythons; the counts go into a table of docs/portability.md.

python -m tools.portability python3.12 python3.13                     # quick and long tests, some hours
python -m tools.portability python3.13 -- -m "not long" tests/drivers  # with other arguments for pytest

Each interpreter gets a copy of HEAD with an environment of its own.
"""

import argparse
import datetime as dt
import os
import platform
import subprocess
import sys
import tempfile
from pathlib import Path
from xml.etree import ElementTree as ET

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs/portability.md"
BELOW = (
    "| Python | machine | tests | passed | skipped | failed | minutes | pytest arguments | commit, day |\n"
)
ALL = ["-m", "long or not long"]


def tested(python: str, words: list[str]) -> str:
    """Row of the table: results of the tests of HEAD with an interpreter."""
    with tempfile.TemporaryDirectory() as scratch:
        tree = Path(scratch) / "tree"
        subprocess.run(["git", "clone", "--quiet", ROOT, tree], check=True)
        subprocess.run(["make", "fmu", "viewers"], cwd=tree, env=os.environ | {"PYTHON": python}, check=True)
        report = Path(scratch) / "report.xml"
        command = [f"{tree}/.venv/bin/python", "-m", "pytest", "-q", "-n", "auto", "--maxprocesses", "4"]
        command += ["--dist", "worksteal", "-o", "faulthandler_timeout=1500", f"--junitxml={report}", *words]
        subprocess.run(command, cwd=tree, check=False)
        suite = ET.parse(report).getroot()[0].attrib  # noqa: S314 - pytest has just written it
        version = subprocess.run(
            [tree / ".venv/bin/python", "-V"], capture_output=True, text=True, check=True
        )
        commit = subprocess.run(
            ["git", "-C", tree, "log", "-1", "--format=%h"], capture_output=True, text=True, check=True
        )
    tests, skipped = int(suite["tests"]), int(suite["skipped"])
    failed = int(suite["failures"]) + int(suite["errors"])
    counts = f"{tests} | {tests - skipped - failed} | {skipped} | {failed} | {float(suite['time']) / 60:.0f}"
    shown = "all" if words == ALL else f"`{' '.join(words)}`"
    where = f"{version.stdout.split()[1]} | {platform.system()} {platform.machine()}"
    return f"| {where} | {counts} | {shown} | {commit.stdout.strip()}, {dt.date.today()} |\n"  # noqa: DTZ011


def main() -> None:
    """Test with each interpreter; an earlier row of the same version and machine is replaced."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("python", nargs="+", help="interpreters, as names on PATH or paths")
    words = sys.argv[1:]
    cut = words.index("--") if "--" in words else len(words)
    for python in parser.parse_args(words[:cut]).python:
        row = tested(python, words[cut + 1 :] or ALL)
        head, table = PAGE.read_text().split(BELOW)
        begin = " | ".join(row.split(" | ")[:2])
        kept = [line for line in table.splitlines(keepends=True) if not line.startswith(begin)]
        PAGE.write_text(head + BELOW + kept[0] + row + "".join(kept[1:]))
        print(row, end="")


if __name__ == "__main__":
    main()
