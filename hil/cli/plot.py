"""The command `hil plot`: its options and help text."""

from pathlib import Path
from typing import Any

import click

from hil.cli import shared

COLUMN = "Column of a panel, as column, column.element or 'one - other'; may be repeated."


@click.command()
@click.argument("logs", type=shared.FILE, nargs=-1, required=True, metavar="LOG...")
@shared.option("-c --column columns", str, "NAME", COLUMN, multiple=True)
@shared.option("--from start_s", shared.NOT_NEGATIVE, "S", "Begin S seconds after the first tick.")
@shared.option("--to end_s", shared.NOT_NEGATIVE, "S", "End S seconds after the first tick.")
@shared.out_option
@shared.force_option
@shared.reporting
def command(logs: tuple[Path, ...], columns: tuple[str, ...], **options: Any) -> None:
    """Draw columns of logs over time, one panel per name, all logs in the same panels, as PNG or SVG.

    Without --column: leg error, force, mode. The picture goes to --out, else next to the first log, as
    ...-plot.png.

    \b
    Examples:
      hil plot before.mcap after.mcap -c tau.leg_3 -c "q_d - q" --from 2 --to 3 --out change.svg
      hil plot fault.mcap -c mode -c faults -c warnings -c lyapunov_share

    Guide: docs/guides/columns.md, which lists the columns.
    """
    start_s, end_s = options["start_s"], options["end_s"]
    if start_s is not None and end_s is not None and end_s <= start_s:
        raise click.UsageError(f"--to {end_s:g} is not after --from {start_s:g}.")
    from hil.study.plot import plot

    shared.finish("plot", plot(logs, columns, **options))
