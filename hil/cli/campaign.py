"""`hil campaign FILE`, and `hil campaign rerun FILE ROW`: a row of it again."""

import time
from datetime import timedelta
from pathlib import Path
from typing import Any

import click

from hil.cli.shared import (
    FILE,
    OUTPUT,
    OrOther,
    finish,
    flag,
    jobs_option,
    junit_option,
    option,
    reporting,
    write_cases,
)

SAY_S = 20.0
"""Where there is no terminal for a bar, a line of progress comes that often."""
FOLDER = click.Path(file_okay=False, path_type=Path)


@click.command("rerun")
@click.argument("file", metavar="FILE", type=FILE)
@click.argument("row", type=click.IntRange(min=0))
@option("--out", FOLDER, "FOLDER", "Where the campaign's results are, if named.")
@option(
    "--log",
    OUTPUT,
    "[FILE]",
    "Record it; without FILE as runs/NAME-row-ROW-TIME.mcap. With the plant's truth beside it.",
    is_flag=False,
    flag_value="",
)
@reporting
def rerun(file: Path, row: int, out: Path | None, log: Path | None) -> None:
    """Run row ROW of the campaign FILE again and compare its figures, to the bit, with the stored ones.

    With --log the run is recorded, and the figures of the log are compared, too. Put --log last, or name its
    file. Without --out a row that is not stored can be recorded, too: nothing is compared then.

    \b
    Examples:
      hil campaign rerun payload 17 --log
      hil campaign rerun my-campaign.yaml 3 --log row3.mcap

    Guide: docs/guides/campaigns.md.
    """
    from hil.study.campaign.plan import read_plan
    from hil.study.campaign.rerun import rerun

    plan = read_plan(file)
    summary = rerun(plan, out, row, log)
    finish("campaign rerun", summary)


class _OrRerun(OrOther):
    other = rerun


@click.command(cls=_OrRerun)
@click.argument("file", metavar="FILE", type=FILE)
@option("--out", FOLDER, "FOLDER", "Of the results; default runs/NAME-campaign.")
@jobs_option
@option(
    "--scheduler", str, "ADDRESS", "Run on the workers of a Dask cluster instead, as tcp://10.0.0.5:8786."
)
@flag("--fresh", "Discard the rows that are there, and begin anew.")
@option(
    "--page", OUTPUT, "FILE", "HTML page, an existing one is refused; default: report.html in the folder."
)
@junit_option
@reporting
def command(
    file: Path,
    out: Path | None,
    page: Path | None,
    junit: Path | None,
    **options: Any,
) -> None:
    """Run a configuration many times in simulated time, with its keys swept, and count how often it fails.

    FILE is a YAML file, or the name of a shipped campaign: payload. It states which keys of which
    configuration take which values, and the limits that a run has to keep. Rows are kept as they come, in
    FOLDER/campaign.sqlite; the same command goes on with the rows that are missing. Nothing is recorded:
    `hil campaign rerun FILE ROW --log` makes any row again, with its log.

    \b
    Examples:
      hil campaign payload                        the shipped example: 500 runs of `virtual`
      hil campaign my.yaml --jobs 8 --junit campaign.xml
      hil campaign my.yaml --scheduler tcp://10.0.0.5:8786
      hil campaign rerun payload 17 --log         one row again, recorded

    Guide: docs/guides/campaigns.md.
    """
    if options["jobs"] is not None and options["scheduler"] is not None:
        raise click.UsageError("--jobs counts processes here, --scheduler runs elsewhere: give one of them.")
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    from hil.app.files import new_file
    from hil.app.output import console, further
    from hil.study.campaign.command import run_campaign
    from hil.study.campaign.plan import read_plan
    from hil.study.campaign.show import show, summary_lines, verdicts, write_page

    if page is not None:
        new_file(page, option="--page")
    plan = read_plan(file)
    folder = plan.folder if out is None else out
    columns = (
        TextColumn("running rows"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]}"),
        TimeRemainingColumn(compact=True),
        TextColumn("left"),
    )
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("", total=len(plan), rate="")

        said = time.monotonic()

        def progress(done: int, of: int) -> None:
            nonlocal said
            speed = bar.tasks[0].speed
            bar.update(task, completed=done, total=of, rate="" if speed is None else f"{speed:.2g} rows/s,")
            if not console.is_terminal and speed and time.monotonic() - said >= SAY_S:
                said = time.monotonic()
                left = timedelta(seconds=round((of - done) / speed))
                click.echo(f"row {done} of {of}, {speed:.2g} rows/s, {left} left", err=True)

        summary = run_campaign(plan, folder, progress=progress, **options)
    show(plan, summary, out)
    target = folder / "report.html" if page is None else page
    with further(summary):
        write_page(target, plan, summary, out)
        summary["page"] = str(target)
    write_cases(summary, junit, f"hil campaign {plan.name}", verdicts(plan, summary, out))
    finish("campaign", summary, summary_lines(plan, summary))
