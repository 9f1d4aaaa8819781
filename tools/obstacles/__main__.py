"""`python -m tools.obstacles`: which command met which obstacle, what it said, how it ended."""

from __future__ import annotations

import os
import re
import sys
import tempfile
from collections.abc import Iterable, Iterator
from itertools import groupby
from pathlib import Path

import click

from tools.obstacles.commands import COMMANDS
from tools.obstacles.meet import Met, Scene
from tools.obstacles.obstacles import OBSTACLES


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.option("--command", "commands", multiple=True, type=click.Choice(list(COMMANDS)), help="Only these.")
@click.option(
    "--obstacle", "obstacles", multiple=True, type=click.Choice(list(OBSTACLES)), help="Only these."
)
@click.option("--table", type=click.Path(path_type=Path), help="Markdown file to write the table into, too.")
def main(commands: tuple[str, ...], obstacles: tuple[str, ...], table: Path | None) -> None:
    """Let every command meet every obstacle.

    One line a case: exit code, time, what was said. Exit code 1 where one left a traceback, a process, half a
    file or silence, was refused late or in more than one line, or failed with nothing in the way.
    """
    bad, seen = 0, []
    with tempfile.TemporaryDirectory(prefix="hil-obstacles-") as name:
        scene = Scene(Path(name))
        for obstacle in obstacles or OBSTACLES:
            if OBSTACLES[obstacle].root_only and os.geteuid() != 0:
                print(f"{obstacle}: only root can put it there")
                continue
            for command in commands or COMMANDS:
                met = scene.meet(command, obstacle)
                seen.append(met)
                bad += bool(met.wrong)
                end = f"{met.outcome.code:4d} {met.outcome.wall_s:6.2f} s  {_said(met)}"
                print(f"{obstacle:14s} {command:8s} {end}")
                for each in met.wrong:
                    print(f"    WRONG: {each}")
                sys.stdout.flush()
            if table is not None:
                table.write_text("\n".join(rows(seen)) + "\n")
    print(f"{bad} cases are wrong" if bad else "no case is wrong")
    sys.exit(1 if bad else 0)


def rows(seen: Iterable[Met]) -> Iterator[str]:
    """Yield the lines of a table in Markdown: an obstacle, what works, what does not and says why."""
    yield "| in the way | works | does not, with exit code | what is said |"
    yield "|---|---|---|---|"
    for obstacle, group in groupby(seen, key=lambda met: met.obstacle):
        cases = list(group)
        works = ", ".join(met.command for met in cases if not met.outcome.code)
        failed = sorted(
            (met for met in cases if met.outcome.code), key=lambda met: (met.outcome.code, _said(met))
        )
        first = True
        for (code, said), alike in groupby(failed, key=lambda met: (met.outcome.code, _said(met))):
            names = ", ".join(met.command for met in alike)
            head = f"| {OBSTACLES[obstacle].text} | {works}" if first else "| |"
            yield f"{head} | {names}: {code} | {said} |"
            first = False
        if first:
            yield f"| {OBSTACLES[obstacle].text} | {works} | | |"


def _said(met: Met) -> str:
    """Return the last of what a case said of it, without the folder of the case and the time in names."""
    if not met.outcome.code or not met.said:
        return ""
    said = re.sub(r"\S*/hil-obstacles-[^/\s]*/[^/\s]*/(?:work/)?", "", met.said[-1].removeprefix("hil: "))
    return re.sub(r"-\d{8}T\d{6}", "-TIME", said).replace("|", "\\|")


if __name__ == "__main__":
    main()
