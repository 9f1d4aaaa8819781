"""The command `hil view`: its options and help text."""

from pathlib import Path
from typing import Any

import click

from hil.cli import shared

VIEWER = click.Choice(["rerun", "foxglove", "plotjuggler"])


@click.command()
@click.argument("log", type=shared.FILE)
@shared.option("--with viewer", VIEWER, None, "Viewer; default: rerun.", default="rerun")
@shared.flag("--no-start", "Write the file without starting the viewer.")
@shared.out_option
@shared.force_option
@shared.reporting
def command(log: Path, viewer: str, no_start: bool, **options: Any) -> None:
    """Open LOG in a viewer: the robot in 3D, plots of errors, forces and timing, states and faults by name.

    Writes a Rerun recording, or a layout for Lichtblick and Foxglove or for PlotJuggler, and starts the
    viewer. The file goes to --out, else next to the log, replacing an earlier one.

    \b
    Examples:
      hil view runs/today.mcap --with plotjuggler
      hil view runs/today.mcap --with foxglove --no-start --out layout.json

    Guide: docs/guides/viewers.md.
    """
    from hil.study.view.command import view

    shared.finish("view", view(log, viewer, start=not no_start, **options))
