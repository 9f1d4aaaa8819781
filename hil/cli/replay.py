"""`hil replay`."""

from pathlib import Path
from typing import Any

import click

from hil.cli import replay_forms
from hil.cli.shared import FILE, OUTPUT, complete_configuration, finish, reporting


@click.command()
@click.argument("log", type=FILE, required=False)
@click.option(
    "--salvage",
    type=OUTPUT,
    metavar="OUT",
    help="Recover a log cut by power loss into the new file OUT first, and replay that.",
)
@click.option(
    "--what-if",
    metavar="CONFIG",
    shell_complete=complete_configuration,
    help="What the controller of CONFIG would have sent on the recorded measurements.",
)
@click.option(
    "--set",
    "words",
    multiple=True,
    metavar="KEY=VALUE",
    help="The same with a key changed, as controller.wn_rad_s=25: of the log's own configuration, or of "
    "CONFIG; may be repeated.",
)
@click.option(
    "--plot", "picture", type=OUTPUT, metavar="FILE", help="With a what-if: PNG or SVG of the forces."
)
@click.option("--log", "out", type=OUTPUT, metavar="OUT", help="With a what-if: write it as a log, too.")
@click.option(
    "--against", type=FILE, metavar="OTHER", help="Compare LOG with the log OTHER, column by column."
)
@click.option(
    "--tolerance",
    "tolerances",
    multiple=True,
    metavar="COLUMN=VALUE",
    help="With --against: allowed in the column's unit, inf: not judged; or one number, relative, for the "
    "others.",
)
@click.option(
    "--align",
    type=click.Choice(["tick", "motion"]),
    help="With --against: rows of one number (default), or counted from the first motion.",
)
@click.option(
    "--suite",
    type=click.Path(path_type=Path),
    metavar="DIR",
    help="Replay every *.mcap in the folder DIR and below.",
)
@click.option(
    "--jobs",
    type=click.IntRange(min=1),
    metavar="N",
    help="With --suite: processes at once; default: one a processor.",
)
@click.option(
    "--junit",
    type=OUTPUT,
    metavar="FILE",
    help="With --suite: a case a log as JUnit XML; an earlier one goes.",
)
@click.option(
    "--trust-code",
    is_flag=True,
    help="Run a law in a file as the log carries it, if the disk has another one.",
)
@reporting
def command(log: Path | None, json_file: Path | None, **given: Any) -> None:
    """Run the recorded inputs of LOG through the same code and compare every sent frame and every column.

    LOG comes from `hil run` or `hil sim`; its configuration is inside, and it stays as it is. Printed are the
    first tick and each column that differs there, with both values; on another CPU columns may differ by
    1e-9. With --what-if or --set another controller is given the same inputs: its answers, not how the robot
    would have moved. --against compares two logs, --suite replays a folder.

    \b
    Examples:
      hil replay cut.mcap --salvage whole.mcap
      hil replay run.mcap --set controller.wn_rad_s=25 --plot forces.png
      hil replay run.mcap --against golden.mcap --tolerance 1e-9 --tolerance tau=0.5
      hil replay --suite runs --jobs 4 --junit replay.xml

    Guide: docs/guides/replay.md; docs/guides/what-if.md.
    """
    form = replay_forms.chosen_form(log, given)
    if given["trust_code"] and form in ("--suite", "--against"):
        raise click.UsageError(f"--trust-code runs the law of one log: it does not go with {form}.")
    if form == "--suite":
        replay_forms.suite(given["suite"], given, json_file)
        return
    assert log is not None  # else it was refused
    if form == "--against":
        replay_forms.against(log, given, json_file)
        return
    log = _whole(log, given["salvage"])
    if form == "--what-if":
        replay_forms.what_if(log, given, json_file)
    else:
        _replay(log, json_file, trust_code=given["trust_code"])


def _whole(log: Path, salvage: Path | None) -> Path:
    """Return the log to replay: itself, refused where it is damaged, or what is left of it."""
    from hil.record.log import Log

    if salvage is None:
        Log.open(log)
        return log
    from hil.app.terminal import one_line
    from hil.record.salvage import salvage as recover

    report = recover(log, salvage)
    lost = f", {report.ticks_lost} ticks of damaged chunks lost" if report.ticks_lost else ""
    click.echo(
        f"salvaged {report.ticks} ticks into {report.out}, {report.bytes_lost} bytes unreadable{lost}",
        err=True,
    )
    for remark in report.remarks:
        click.echo(one_line(f"  {remark}"), err=True)
    return salvage


def _replay(log: Path, json_file: Path | None, *, trust_code: bool) -> None:
    from hil.app.replay import replay_log
    from hil.app.terminal import one_line

    with replay_forms.counted_ticks() as progress:
        comparison, summary = replay_log(log, progress, trust_code=trust_code)
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
