"""`hil replay`: replay a log or a folder of logs, run another controller on a log, compare two logs."""

import time
from pathlib import Path
from typing import Any, NoReturn

import click

from hil.cli import shared

_FORM_OF = {
    **dict.fromkeys(("words", "out"), "--what-if"),
    **dict.fromkeys(("tolerances", "align"), "--against"),
    **dict.fromkeys(("jobs", "junit"), "--suite"),
}
"""Parameter -> option that must be given with it."""
SALVAGE = "First recover a log truncated by power loss into the new file OUT, then replay OUT."
WHAT_IF = "What the controller of CONFIG would have sent on the recorded measurements."
SET = "The same with a changed key, as controller.wn_rad_s=25, of CONFIG or of the log's configuration."
TOLERANCE = "With --against: allowed, in the column's unit, inf: any; or a number, relative, for all others."
ALIGN = "With --against: pair rows by tick number (default), or counted from the first motion."
TRUST = "Run the law file contained in the log, even if the file on disk differs."
CONFIGURATIONS = shared.complete_configuration


@click.command()
@click.argument("log", type=shared.FILE, required=False)
@shared.option("--salvage", shared.OUTPUT, "OUT", SALVAGE)
@shared.option("--what-if", str, "CONFIG", WHAT_IF, shell_complete=CONFIGURATIONS)
@shared.option("--set words", str, "KEY=VALUE", SET, multiple=True)
@shared.option("--log out", shared.OUTPUT, "OUT", "With a what-if: also write its outputs as a log.")
@shared.option("--against", shared.FILE, "OTHER", "Compare LOG with the log OTHER, column by column.")
@shared.option("--tolerance tolerances", str, "COLUMN=VALUE", TOLERANCE, multiple=True)
@shared.option("--align", click.Choice(["tick", "motion"]), None, ALIGN)
@shared.option(
    "--suite", click.Path(path_type=Path), "DIR", "Replay every *.mcap in the folder DIR and below."
)
@shared.jobs_option
@shared.junit_option
@shared.flag("--trust-code", TRUST)
@shared.reporting
def command(log: Path | None, **given: Any) -> None:
    """Run the recorded inputs of LOG through the same code and compare every sent frame and every column.

    LOG comes from `hil run` or `hil sim`; it contains its configuration and is not changed. Prints the first
    tick with a difference and each column that differs there, with both values; on another CPU columns may
    differ by 1e-9. With --what-if or --set another controller receives the same inputs: this shows its
    outputs, not how the robot would have moved. --against compares two logs, --suite replays a folder.

    \b
    Examples:
      hil replay run.mcap --set controller.wn_rad_s=25 --log answer.mcap
      hil replay run.mcap --against golden.mcap --tolerance 1e-9 --tolerance tau=0.5
      hil replay --suite runs --jobs 4 --junit replay.xml

    Guide: docs/guides/replay.md; docs/guides/what-if.md.
    """
    form = _chosen_form(log, given)
    if form == "--suite":
        _suite(given["suite"], given)
    assert log is not None  # else it was refused
    if form == "--against":
        _against(log, given)
    log = _whole(log, given["salvage"])
    if form == "--what-if":
        _what_if(log, given)
    _replay(log, trust_code=given["trust_code"])


def _chosen_form(log: Path | None, given: dict[str, Any]) -> str:
    """Option that selects the form of the command, or "". Raises UsageError if options exclude each other."""
    option_of = {each.name: each.opts[0] for each in click.get_current_context().command.params}
    there = {name: option_of[name] for name, value in given.items() if value not in (None, (), False)}
    forms = [form for form in ("--what-if", "--against", "--suite") if form in there.values()]
    if "words" in there and "what_if" not in there:
        forms.insert(0, "--set")
    if len(forms) > 1:
        raise click.UsageError(f"{' and '.join(forms)} exclude each other: give one of them.")
    form = "--what-if" if forms == ["--set"] else "".join(forms)
    for name, given_as in there.items():
        if (wanted := _FORM_OF.get(name, form)) != form:
            needed = "--what-if CONFIG or --set KEY=VALUE" if wanted == "--what-if" else wanted
            raise click.UsageError(f"{given_as} needs {needed}.")
        if name in {"salvage", "trust_code"} and form in {"--against", "--suite"}:
            raise click.UsageError(f"{given_as} applies to the replay of one log, not to {form}.")
    if form == "--suite" and log is not None:
        raise click.UsageError(f"--suite takes a folder and no LOG: leave out {log}.")
    if form != "--suite" and log is None:
        raise click.UsageError("Missing argument 'LOG'.")
    return form


def _whole(log: Path, salvage: Path | None) -> Path:
    """Log to replay: the given one, refused if damaged, or its salvaged copy."""
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


def _replay(log: Path, *, trust_code: bool) -> NoReturn:
    from hil.app.replay import replay_log
    from hil.app.terminal import one_line

    with shared.status("") as progress:
        comparison, summary = replay_log(log, lambda n: progress(f"{n} ticks"), trust_code=trust_code)
    for difference in comparison.first:
        click.echo(one_line(f"hil: {difference}"), err=True)
    result = {"success": summary["agrees"], "kind": "replay", "log": str(log), **summary}
    if comparison.story is not None:
        result["story"] = comparison.story.fields()
    short = {key: result.get(key) for key in ("success", "log", "wall_s", "times_real_time", "remark")}
    if not comparison.exact:
        short["largest_relative_difference"] = comparison.largest
    shared.finish("replay", result, {**short, "replay": summary})


def _what_if(log: Path, given: dict[str, Any]) -> NoReturn:
    from hil.app.output import show_lines
    from hil.study.what_if.command import shown, story, tables, what_if_log

    options = {name: given[name] for name in ("out", "trust_code")}
    with shared.status("") as row:
        options["progress"] = lambda ticks: row(f"{ticks} ticks")
        result = what_if_log(log, given["what_if"], given["words"], **options)
    tables(result)
    show_lines(story(result))
    shared.finish("what-if", result, shown(result))


def _against(log: Path, given: dict[str, Any]) -> NoReturn:
    from hil.study.log_comparison import against, show, shown

    result = against(log, given["against"], given["tolerances"], align=given["align"] or "tick")
    show(result)
    shared.finish("compared", result, shown(result))


def _suite(folder: Path, given: dict[str, Any]) -> NoReturn:
    from hil.study.replay_suite import Case, logs_in, run_suite, show, summary, verdicts

    paths = logs_in(folder)
    cases: list[Case] = []
    begun = time.perf_counter()
    try:
        with shared.counted("replaying") as progress:
            for case in run_suite(paths, given["jobs"], progress):
                cases.append(case)  # noqa: PERF402 - one by one: an interrupt shows those that are done
    except KeyboardInterrupt:
        show(folder, cases)
        raise KeyboardInterrupt(f"with {len(cases)} of {len(paths)} logs replayed") from None
    wall_s = time.perf_counter() - begun
    show(folder, cases)
    result = summary(folder, cases, wall_s)
    shared.write_cases(result, given["junit"], f"hil replay {folder}", verdicts(folder, cases))
    shown = {key: value for key, value in result.items() if key != "cases"}
    shared.finish("replay of a folder", result, shown)
