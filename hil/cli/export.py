"""The command `hil export`: its options and help text."""

from pathlib import Path
from typing import Any

import click

from hil.cli import shared

START = "UTC of the first tick, ISO 8601; default: from the log; simulated time begins at 2000-01-01."
COLUMN = "Only this column (tau) or component (tau.leg_3) in .csv, .parquet, .rrd; may be repeated."


@click.command()
@click.argument("log", type=shared.FILE)
@click.argument("out", nargs=-1, required=True, type=shared.FILE)
@shared.option("--start", str, "TIME", START)
@shared.option("--column columns", str, "NAME", COLUMN, multiple=True)
@shared.flag("--force overwrite", "Replace files that exist.")
@shared.reporting
def command(log: Path, out: tuple[Path, ...], **options: Any) -> None:
    """Write LOG's CAN frames and columns to files for other tools; the file ending selects the format.

    \b
      .log .candump  frames as `candump -L` writes them: canplayer, Wireshark, SavvyCAN
      .asc           frames as Vector's ASCII log (its start is in local time)
      .blf           frames as Vector's binary log
      .csv           columns, one per component, named with its unit
      .parquet       the same with units and meanings as metadata (needs the extra `analysis`)
      .rrd           Rerun: scalars, states and events by name, the robot in 3D (extra `viewers`)

    A truncated log is exported up to its last readable message.

    \b
    Examples:
      hil export runs/today.mcap today.log today.parquet
      hil export runs/today.mcap forces.csv --column tau --column mode

    Guide: docs/guides/analysis.md.
    """
    from hil.study.export import export_log

    shared.finish("export", export_log(log, out, **options))
