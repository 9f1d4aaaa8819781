"""`hil campaign FILE`, and `hil campaign rerun FILE ROW`, which repeats one row."""

from pathlib import Path
from typing import Any

import click

from hil.cli import shared

FOLDER = click.Path(file_okay=False, path_type=Path)
LOG = "Record controller and plant; default FILE: runs/NAME-row-ROW-TIME.mcap, if the option comes last."


@click.command("rerun")
@click.argument("file", metavar="FILE", type=shared.FILE)
@click.argument("row", type=click.IntRange(min=0))
@shared.option("--out", FOLDER, "FOLDER", "Folder with the results of the campaign, if it ran with --out.")
@shared.option("--log", shared.OUTPUT, "[FILE]", LOG, is_flag=False, flag_value="")
@shared.reporting
def rerun(file: Path, row: int, out: Path | None, log: Path | None) -> None:
    """Run row ROW of the campaign FILE again and compare its figures, to the bit, with the stored ones.

    With --log the run is recorded, and the figures of the log are compared, too. A row that is not stored can
    also be recorded; then there are no figures to compare.

    \b
    Examples:
      hil campaign rerun payload 17 --log
      hil campaign rerun my-campaign.yaml 3 --log row3.mcap

    Guide: docs/guides/campaigns.md.
    """
    from hil.study.campaign.plan import read_plan
    from hil.study.campaign.rerun import rerun

    shared.finish("campaign rerun", rerun(read_plan(file), out, row, log))


class _OrRerun(shared.OrOther):
    others = (rerun,)


@click.command(cls=_OrRerun)
@click.argument("file", metavar="FILE", type=shared.FILE)
@shared.option("--out", FOLDER, "FOLDER", "Folder of the results; default runs/NAME-campaign.")
@shared.jobs_option
@shared.option("--scheduler", str, "ADDRESS", "Run on the workers of a Dask cluster, as tcp://10.0.0.5:8786.")
@shared.flag("--fresh", "Discard the stored rows and start again.")
@shared.junit_option
@shared.reporting
def command(file: Path, out: Path | None, junit: Path | None, **options: Any) -> None:
    """Run a configuration many times in simulated time, with swept keys, and count the failures.

    FILE is a YAML file, or the name of a shipped campaign: payload. It states a configuration, the values
    of its swept keys, and the limits of a run. Each finished row is stored in FOLDER/campaign.sqlite; the
    same command continues with the missing rows. No logs are written: `hil campaign rerun FILE ROW --log`
    repeats a row and records its log.

    \b
    Examples:
      hil campaign payload                        the shipped example: 500 runs of `virtual`
      hil campaign my.yaml --jobs 8 --junit campaign.xml

    Guide: docs/guides/campaigns.md.
    """
    if options["jobs"] is not None and options["scheduler"] is not None:
        raise click.UsageError("--jobs is for this machine, --scheduler for a cluster: give one of them.")
    from hil.app.output import further
    from hil.study.campaign.command import run_campaign
    from hil.study.campaign.plan import read_plan
    from hil.study.campaign.show import show, summary_lines, verdicts, write_page

    plan = read_plan(file)
    folder = plan.folder if out is None else out
    with shared.counted("running rows") as progress:
        summary = run_campaign(plan, folder, progress=progress, **options)
    show(plan, summary, out)
    target = folder / "report.html"
    with further(summary):
        write_page(target, plan, summary, out)
        summary["page"] = str(target)
    shared.write_cases(summary, junit, f"hil campaign {plan.name}", verdicts(plan, summary, out))
    shared.finish("campaign", summary, summary_lines(plan, summary))
