"""`hil replay`."""

import sys
from pathlib import Path

import click

from hil.cli.shared import FILE, finish, reporting


@click.command()
@click.argument("log", type=FILE)
@click.option(
    "--salvage",
    type=FILE,
    metavar="OUT",
    help="Recover a log cut by power loss into the new file OUT first, and replay that.",
)
@reporting
def command(log: Path, salvage: Path | None, json_file: Path | None) -> None:
    """Run the recorded inputs of LOG through the same code and compare every sent frame and every column.

    LOG comes from `hil run` or `hil sim`; its configuration is inside. Only reads: nothing is sent, LOG
    stays as it is. Names the first tick and each column that differs there, with both values.

    \b
    Examples:
      hil replay runs/virtual-20260131T120000.mcap
      hil replay cut.mcap --salvage whole.mcap

    \b
    Exit code:
      0  all ticks identical to the bit (on another CPU: all frames, columns to 1e-9)
      1  differences, or ticks missing from the log
      2  not begun: no such file, no log, made by another version, cut (then use --salvage)
    """
    from hil.record.log import Log

    if salvage is None:
        Log.open(log)
    from hil.app.replay import replay_log
    from hil.app.terminal import one_line
    from hil.record.salvage import salvage as recover

    if salvage is not None:
        report = recover(log, salvage)
        lost = f", {report.ticks_lost} ticks of damaged chunks lost" if report.ticks_lost else ""
        click.echo(
            f"salvaged {report.ticks} ticks into {report.out}, {report.bytes_lost} bytes unreadable{lost}",
            err=True,
        )
        for remark in report.remarks:
            click.echo(one_line(f"  {remark}"), err=True)
        log = salvage

    def tell(ticks: int) -> None:
        click.echo(f"\r{ticks} ticks", err=True, nl=False)

    shown = sys.stderr.isatty()
    comparison, summary = replay_log(log, tell if shown else None)
    if shown:
        click.echo("\r\x1b[K", err=True, nl=False)
    for difference in comparison.first:
        click.echo(one_line(f"hil: {difference}"), err=True)
    result = {"success": summary["agrees"], "kind": "replay", "log": str(log), **summary}
    if comparison.story is not None:
        result["story"] = comparison.story.fields()
    short = {key: result[key] for key in ("success", "log", "wall_s", "times_real_time")}
    if "remark" in summary:
        short["remark"] = summary["remark"]
    if not comparison.exact:
        short["largest_relative_difference"] = comparison.largest
    finish("replay", result, json_file, {**short, "replay": summary})
