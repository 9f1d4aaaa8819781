"""`hil export`."""

from pathlib import Path
from typing import Any

import click

from hil.cli.shared import FILE, finish, flag, option, reporting


@click.command()
@click.argument("log", type=FILE)
@click.argument("out", nargs=-1, required=True, type=FILE)
@option(
    "--start",
    str,
    "TIME",
    "UTC of the first tick, ISO 8601; default: the log's own, in simulated time 2000-01-01.",
)
@option(
    "--column columns",
    str,
    "NAME",
    "Only this column (tau) or component (tau.leg_3) in .csv, .parquet, .rrd; may be repeated.",
    multiple=True,
)
@flag("--force overwrite", "Replace files that exist.")
@reporting
def command(log: Path, out: tuple[Path, ...], **options: Any) -> None:
    """Write LOG's CAN frames and columns into files that other tools read, each by its ending.

    \b
      .log .candump  frames as `candump -L` writes them: canplayer, Wireshark, SavvyCAN
      .asc           frames as Vector's ASCII log (its start is in local time)
      .blf           frames as Vector's binary log
      .csv           columns, one for each component, named with its unit
      .parquet       the same with units and meanings as metadata (needs the extra `analysis`)
      .rrd           Rerun: scalars, states and events by name, the robot in 3D (extra `viewers`)

    Simulated time begins on 2000-01-01: --start moves the first tick elsewhere. A log that was cut is
    exported as far as it goes.

    \b
    Examples:
      hil export runs/today.mcap today.log today.blf
      hil export sim.mcap sim.asc --start 2026-01-31T12:00:00+01:00
      hil export runs/today.mcap forces.csv --column tau --column mode
      hil export runs/today.mcap today.parquet

    Guide: docs/guides/analysis.md.
    """
    from hil.study.export import export_log

    finish("export", export_log(log, out, **options))
