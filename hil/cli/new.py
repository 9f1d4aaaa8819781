"""The command `hil new`: its options and help text."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import click

from hil.cli import shared

if TYPE_CHECKING:
    from hil.app.new.answers import Question


class _Asked(click.Command):
    """A command with one option for each question of `hil new`, imported only when the command is called."""

    def get_params(self, ctx: click.Context) -> list[click.Parameter]:
        """Parameters of the command; the options of the questions come before --json, the last one."""
        from hil.app.new.answers import QUESTIONS

        added: list[click.Parameter] = []
        for question in QUESTIONS:
            default = "" if question.default is None else "; has a default"
            unit = question.unit.upper().replace(" ", "_") or None
            names = [question.option, question.key]
            added.append(click.Option(names, help=question.text + default, type=question.kind, metavar=unit))
        parameters = super().get_params(ctx)
        return [*parameters[:-1], *added, parameters[-1]]


@click.command(cls=_Asked)
@click.argument("file", type=shared.FILE)
@click.argument("name", required=False)
@shared.option("--fmu", shared.FILE, None, "Your own co-simulation FMU, instead of the built-in plant.")
@shared.option("--from source", shared.FILE, "URDF", "Take joints, stroke and masses from a URDF.")
@shared.flag("--yes", "Ask nothing and take defaults. A question without a default needs its option.")
@shared.force_option
@shared.reporting
def command(
    file: Path, name: str | None, fmu: Path | None, source: Path | None, yes: bool, force: bool, **given: Any
) -> None:
    """Write a configuration of your robot into FILE, from a few figures.

    `hil new law NAME` and `hil new protocol NAME` write a package for a law or a drive family of your own
    into the folder NAME; the package runs and passes its contract suite unchanged.

    Asks for each figure not given as an option, with its unit and range, and refuses an impossible answer at
    once. The other numbers follow from rules, which FILE states next to them, or are usual values, marked
    as such; none comes from another robot. FILE passes `hil check`, whose warnings are printed.

    \b
    Examples:
      hil new my.yaml --fmu my_robot.fmu
      hil new my.yaml --from my_robot.urdf
      hil new my.yaml --drives cubemars --model AK80-9 --travel 0.126
      hil new law soft

    Guide: docs/guides/parameters.md; docs/guides/own-laws.md; docs/guides/own-drives.md.
    """
    from hil.app.check.command import inspect
    from hil.app.files import new_file, write_whole
    from hil.app.new.answers import QUESTIONS
    from hil.app.new.command import new_configuration, recognised
    from hil.app.new.derive import SLOW_PLANT
    from hil.app.output import show_lines

    if name is not None:
        _skeleton(str(file), name)
    new_file(file, force=force, option="")
    plant = None if fmu is None else (fmu, recognised(fmu))
    known = {SLOW_PLANT: plant is not None and plant[1].needs_tool}
    if source is not None:
        from hil.app.new.urdf import read_urdf

        known |= read_urdf(source)
    answers = known | _answers(QUESTIONS, given, known, ask=not yes)
    text, configuration = new_configuration(answers, file, plant)
    report = inspect(configuration)
    write_whole(file, text)
    show_lines([f"{file}: written", *(f"warning: {w}" for w in report.warnings)])
    click.echo(f"next: hil sim {shlex.quote(str(file))}")  # in one line: it is to be copied
    summary = {"success": True, "kind": "new", "file": str(file), "warnings": report.warnings}
    shared.finish_lines((), summary)


def _skeleton(kind: str, name: str) -> NoReturn:
    from hil.app.new.skeleton import FILES, write_skeleton

    if kind not in FILES:
        raise click.UsageError(f"{kind} {name}: allowed: FILE alone, `law NAME` or `protocol NAME`")
    written = [str(path) for path in write_skeleton(kind, name, Path())]
    lines = [*(f"{path}: written" for path in written), f"next: pip install -e {name}; pytest {name}/tests"]
    shared.finish_lines(lines, {"success": True, "kind": f"new {kind}", "files": written})


def _answers(
    questions: tuple[Question, ...], given: dict[str, Any], known: dict[str, Any], *, ask: bool
) -> dict[str, Any]:
    """Answers to all questions, from options, else from prompts or defaults. Raises ConfigurationError."""
    from drivers.errors import ConfigurationError

    for question in questions:
        if question.key in known and given[question.key] is not None:
            raise ConfigurationError(f"{question.option}: the URDF has it; leave it out")
    questions = tuple(q for q in questions if q.key not in known)
    so_far = given | known
    missing = [q.option for q in questions if given[q.key] is None and q.default is None and q.needed(so_far)]
    if missing and not ask:
        raise ConfigurationError(f"hil new --yes: no default for {', '.join(missing)}: give them as options")
    answers = dict(known)
    for question in questions:
        answer = given[question.key]
        if not question.needed(answers):
            if answer is not None:
                source = f"drives of {answers['drives']}" if "drives" in answers else "a URDF"
                raise ConfigurationError(f"{question.option}: does not apply to {source}; leave it out")
            continue
        default = None if question.default is None else question.default(answers)
        if answer is None and ask:
            answer = _typed(question, default, answers)
        elif answer is None:
            answer = default
        answers[question.key] = answer
        if trouble := question.trouble(answers):
            raise ConfigurationError(f"{question.option}: {trouble}")
    return answers


def _typed(question: Question, default: Any, before: dict[str, Any]) -> Any:
    """Typed answer to a question, which is repeated until the answer is possible.

    Raises KeyboardInterrupt: Ctrl-C; ConfigurationError: Ctrl-D, or the input ended.
    """
    from drivers.errors import ConfigurationError

    def judged(typed: Any) -> Any:
        answer = question.kind(typed)
        if trouble := question.trouble(before | {question.key: answer}):
            raise click.UsageError(f"impossible: {trouble}")
        return answer

    click.echo(question.text + (f" ({question.allowed})" if question.allowed else ""))
    try:
        return click.prompt(f"  {question.key}", default=default, value_proc=judged)
    except click.Abort as error:
        click.echo()
        there = (
            f"at {question.key}, nothing is written; begin again, or give the answers as options "
            f"({question.option} for this one)"
        )
        if isinstance(error.__context__, KeyboardInterrupt):
            raise KeyboardInterrupt(there) from None
        raise ConfigurationError(f"hil new: ended {there}") from None
