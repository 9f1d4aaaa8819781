"""What `hil replay` does beside a replay: a what-if, a comparison of two logs, a folder of logs."""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click

from hil.cli.shared import counted, finish, write_cases

OF_FORM = {
    "--set": "--what-if",
    "--plot": "--what-if",
    "--log": "--what-if",
    "--tolerance": "--against",
    "--align": "--against",
    "--jobs": "--suite",
    "--junit": "--suite",
}
"""Options that belong to one form."""
_KEYS = {
    "--what-if": "what_if", "--against": "against", "--suite": "suite", "--salvage": "salvage",
    "--set": "words", "--plot": "picture", "--log": "out", "--tolerance": "tolerances", "--align": "align",
    "--jobs": "jobs", "--junit": "junit",
}  # fmt: skip


def chosen_form(log: Path | None, given: dict[str, Any]) -> str:
    """Return which form is asked for: its option, or nothing. Raises UsageError for what excludes another."""
    there = [option for option, key in _KEYS.items() if given[key] not in (None, ())]
    forms: list[str] = [option for option in ("--what-if", "--against", "--suite") if option in there]
    asked = forms
    if "--set" in there and "--what-if" not in there:
        forms, asked = ["--what-if", *forms], ["--set (a what-if)", *asked]
    if len(forms) > 1:
        raise click.UsageError(f"{' and '.join(asked)} are different questions: give one of them.")
    form = forms[0] if forms else ""
    for option in there:
        wanted = OF_FORM.get(option, form)
        if wanted != form:
            needed = "--what-if CONFIG or --set KEY=VALUE" if wanted == "--what-if" else wanted
            raise click.UsageError(f"{option} belongs to {needed}, which is not given.")
    if "--salvage" in there and form in ("--against", "--suite"):
        raise click.UsageError(f"--salvage recovers one log before its replay: it does not go with {form}.")
    if form == "--suite" and log is not None:
        raise click.UsageError(f"--suite takes a folder, and no LOG beside it: {log}.")
    if form != "--suite" and log is None:
        raise click.UsageError("Missing argument 'LOG'.")
    return form


@contextmanager
def counted_ticks() -> Iterator[Callable[[int], None] | None]:
    """Yield what counts ticks on a terminal, over itself; None elsewhere."""
    if not sys.stderr.isatty():
        yield None
        return
    yield lambda ticks: click.echo(f"\r{ticks} ticks", err=True, nl=False)
    click.echo("\r\x1b[K", err=True, nl=False)


def what_if(log: Path, given: dict[str, Any]) -> None:
    """Answer what another controller would have sent."""
    from hil.app.output import show_lines
    from hil.study.what_if import show
    from hil.study.what_if.command import what_if_log

    with counted_ticks() as progress:
        result = what_if_log(
            log,
            given["what_if"],
            given["words"],
            picture=given["picture"],
            out=given["out"],
            progress=progress,
            trust_code=given["trust_code"],
        )
    show.tables(result)
    show_lines(show.story(result))
    finish("what-if", result, show.shown(result))


def against(log: Path, given: dict[str, Any]) -> None:
    """Say where two logs part."""
    from hil.study.against.command import against
    from hil.study.against.show import show, shown

    result = against(log, given["against"], given["tolerances"], align=given["align"] or "tick")
    show(result)
    finish("compared", result, shown(result))


def suite(folder: Path, given: dict[str, Any]) -> None:
    """Replay every log of a folder."""
    from hil.study.replay_suite import Case, logs_in, run_suite, show, summary, verdicts

    paths = logs_in(folder)
    cases: list[Case] = []
    begun = time.perf_counter()
    try:
        with counted("replaying") as progress:
            for case in run_suite(paths, given["jobs"], progress):
                cases.append(case)  # noqa: PERF402 - one by one: an interrupt shows those that are done
    except KeyboardInterrupt:
        show(folder, cases)
        raise KeyboardInterrupt(f"with {len(cases)} of {len(paths)} logs replayed") from None
    wall_s = time.perf_counter() - begun
    show(folder, cases)
    result = summary(folder, cases, wall_s)
    write_cases(result, given["junit"], f"hil replay {folder}", verdicts(folder, cases))
    shown = {key: value for key, value in result.items() if key != "cases"}
    finish("replay of a folder", result, shown)
