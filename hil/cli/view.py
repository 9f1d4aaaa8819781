"""`hil view`."""

from pathlib import Path
from typing import Any

import click

from hil.cli.shared import FILE, finish, flag, force_option, option, out_option, reporting


@click.command()
@click.argument("log", type=FILE)
@option(
    "--with viewer",
    click.Choice(["rerun", "foxglove", "plotjuggler"]),
    None,
    "Which viewer.",
    default="rerun",
    show_default=True,
)
@flag("--no-start", "Write the file, start nothing.")
@out_option
@force_option
@reporting
def command(log: Path, viewer: str, no_start: bool, **options: Any) -> None:
    """Open LOG in a viewer: the robot in 3D, plots of errors, forces and timing, states and faults by name.

    Writes a Rerun recording, or a layout for Lichtblick and Foxglove or for PlotJuggler, and starts the
    viewer. The file goes to --out, else next to the log, in the place of an earlier one.

    \b
    Examples:
      hil view runs/today.mcap
      hil view runs/today.mcap --with plotjuggler
      hil view runs/today.mcap --with foxglove --no-start --out layout.json

    Guide: docs/guides/viewers.md.
    """
    from hil.study.view.command import view

    finish("view", view(log, viewer, start=not no_start, **options))
