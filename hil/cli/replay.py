"""`hil replay`."""

from pathlib import Path
from typing import Any

import click

from hil.cli import replay_forms
from hil.cli.shared import FILE, OUTPUT, complete_configuration, finish, flag, option, reporting


@click.command()
@click.argument("log", type=FILE, required=False)
@option(
    "--salvage",
    OUTPUT,
    "OUT",
    "Recover a log cut by power loss into the new file OUT first, and replay that.",
)
@option(
    "--what-if",
    str,
    "CONFIG",
    "What the controller of CONFIG would have sent on the recorded measurements.",
    shell_complete=complete_configuration,
)
@option(
    "--set words",
    str,
    "KEY=VALUE",
    "The same with a key changed, as controller.wn_rad_s=25: of the log's own configuration, or of "
    "CONFIG; may be repeated.",
    multiple=True,
)
@option("--plot picture", OUTPUT, "FILE", "With a what-if: PNG or SVG of the forces.")
@option("--log out", OUTPUT, "OUT", "With a what-if: write it as a log, too.")
@option("--against", FILE, "OTHER", "Compare LOG with the log OTHER, column by column.")
@option(
    "--tolerance tolerances",
    str,
    "COLUMN=VALUE",
    "With --against: allowed in the column's unit, inf: not judged; or one number, relative, for the others.",
    multiple=True,
)
@option(
    "--align",
    click.Choice(["tick", "motion"]),
    None,
    "With --against: rows of one number (default), or counted from the first motion.",
)
@option("--suite", click.Path(path_type=Path), "DIR", "Replay every *.mcap in the folder DIR and below.")
@option("--jobs", click.IntRange(min=1), "N", "With --suite: processes at once; default: one a processor.")
@option("--junit", OUTPUT, "FILE", "With --suite: a case a log as JUnit XML; an earlier one goes.")
@flag("--trust-code", "Run a law in a file as the log carries it, if the disk has another one.")
@reporting
def command(log: Path | None, **given: Any) -> None:
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
        replay_forms.suite(given["suite"], given)
        return
    assert log is not None  # else it was refused
    if form == "--against":
        replay_forms.against(log, given)
        return
    log = _whole(log, given["salvage"])
    if form == "--what-if":
        replay_forms.what_if(log, given)
    else:
        _replay(log, trust_code=given["trust_code"])


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


def _replay(log: Path, *, trust_code: bool) -> None:
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
    finish("replay", result, {**short, "replay": summary})
