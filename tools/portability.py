"""`make portability`: all tests with several Pythons; the summaries go into docs/portability.md.

python -m tools.portability python3.12 python3.13                     # quick and long tests, some hours
python -m tools.portability python3.13 -- -m "not long" tests/drivers  # with other arguments for pytest

Each interpreter gets a copy of HEAD with an environment of its own.
"""

import datetime as dt
import os
import platform
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs/portability.md"
BELOW = "| Python | machine | result | pytest arguments | commit, day |\n|---|---|---|---|---|\n"


def output(folder: str, *command: str) -> str:
    """Last line of the output of a command in a folder; its exit code does not count."""
    done = subprocess.run(command, cwd=folder, stdout=subprocess.PIPE, text=True, check=False)
    return (done.stdout.splitlines() or ["no output"])[-1]


def tested(name: str, words: list[str]) -> str:
    """Row of the table: result of the tests of HEAD with the interpreter `name`."""
    with tempfile.TemporaryDirectory() as tree:
        subprocess.run(["git", "clone", "--quiet", ROOT, tree], check=True)
        subprocess.run(["make", "-C", tree, "fmu", "viewers"], env=os.environ | {"PYTHON": name}, check=True)
        python = f"{tree}/.venv/bin/python"
        options = [
            "-q",
            "-n",
            "auto",
            "--maxprocesses",
            "4",
            "--dist",
            "worksteal",
            "-o",
            "faulthandler_timeout=1500",
        ]
        result = output(tree, python, "-m", "pytest", *options, *words)
        version, commit = output(tree, python, "-V"), output(tree, "git", "log", "-1", "--format=%h")
    machine = f"{platform.system()} {platform.machine()}"
    shown = " ".join(words)
    return f"| {version} | {machine} | {result.strip('= ')} | `{shown}` | {commit}, {dt.date.today()} |\n"  # noqa: DTZ011


def main() -> None:
    """Test with each interpreter, and add a row to the table."""
    words = sys.argv[1:]
    cut = words.index("--") if "--" in words else len(words)
    for name in words[:cut]:
        row = tested(name, words[cut + 1 :] or ["-m", "long or not long"])
        PAGE.write_text(PAGE.read_text().replace(BELOW, BELOW + row))
        print(row, end="")


if __name__ == "__main__":
    main()
