"""The command `hil report`: its options and help text."""

from pathlib import Path

import click

from hil.cli.shared import FILE, finish, force_option, out_option, reporting


@click.command()
@click.argument("log", type=FILE)
@click.argument("other", type=FILE, required=False)
@out_option
@force_option
@reporting
def command(log: Path, other: Path | None, out: Path | None, force: bool) -> None:
    """Write one HTML page about a run: its faults, and its margin to every limit.

    With OTHER, a second log, the page has both runs side by side: figures, what differs in their
    configurations, and the curves of one over those of the other.

    The page also has tracking, forces, modes and faults over time, latency, bus load, and the motion in 3D.
    Any browser shows it, without network; a truncated log is shown up to its last readable message. The page
    goes to --out, else next to the log, as ....html.

    \b
    Examples:
      hil report runs/virtual-20260131T120000.mcap
      hil report runs/fault.mcap --out fault.html --force
      hil report runs/before.mcap runs/after.mcap --out change.html

    Guide: docs/guides/report.md.
    """
    from hil.app.files import new_file

    if log.exists():
        new_file(log.with_suffix(".html") if out is None else out, force=force)
    from hil.study.report.command import report

    finish("report", report(log, other, out=out, force=force))
