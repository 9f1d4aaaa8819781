"""Parts of all commands: options, exit with a summary, error messages. Heavy imports are deferred."""

from __future__ import annotations

import itertools
import math
import shlex
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from datetime import timedelta
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NoReturn, cast

import click
from click.shell_completion import CompletionItem

from hil.config.number import ALLOWED, is_allowed

if TYPE_CHECKING:
    from hil.app.configuration.configuration import Configuration
    from hil.study.junit import Verdict


class FiniteRange(click.FloatRange):
    """A finite number within a range; click's own range accepts NaN, which no comparison excludes."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Parse the number; refuse text that is not a number, is not finite or is out of range."""
        number: float = super().convert(value, param, ctx)
        if not (math.isfinite(number) and is_allowed(number)):
            self.fail(f"{value!r}, allowed in size: {ALLOWED}.", param, ctx)
        return number


class Output(click.Path):
    """A file that a command writes; it must differ from all other files of the command."""


def complete_configuration(ctx: click.Context, param: click.Parameter, begun: str) -> list[CompletionItem]:
    """Complete the names of shipped configurations, and files."""
    del ctx, param
    from hil.app.configuration.text_file import shipped

    there = [CompletionItem(name) for name in shipped() if name.startswith(begun)]
    return [*there, CompletionItem(begun, type="file")]


POSITIVE = FiniteRange(min=0, min_open=True)
NOT_NEGATIVE = FiniteRange(min=0)
DURATION = FiniteRange(min=0, max=1e9, min_open=True)
"""Type of a duration, s, up to `hil.app.sim.commands.LATEST_S`."""
FILE = click.Path(dir_okay=False, path_type=Path)
OUTPUT = Output(dir_okay=False, path_type=Path)


def option(names: str, kind: Any, metavar: str | None, text: str, **more: Any) -> Callable[[Any], Any]:
    """Option of a command. metavar : placeholder of its value in the help; text : the help itself."""
    return click.option(*names.split(), type=kind, metavar=metavar, help=text, **more)


def flag(names: str, text: str) -> Callable[[Any], Any]:
    """Option of a command without a value. text : its help."""
    return click.option(*names.split(), is_flag=True, help=text)


log_option = option("--log", OUTPUT, "FILE", "Log file to write; an existing one is refused.")
duration_option = option("--duration duration_s", DURATION, "S", "Stop after S seconds.")
fault_option = option(
    "--fault faults",
    str,
    "WORDS",
    'Fault to inject at the plant, as "encoder_jump leg=0 at=2 by=5e-3"; may be repeated.',
    multiple=True,
)
mistake_option = option(
    "--mistake mistakes",
    str,
    "WORDS",
    'Wiring mistake on the emulated bench, as "encoder_sign leg=2"; may be repeated.',
    multiple=True,
)
picture_option = option("--picture", OUTPUT, "FILE", "PNG file to draw; an earlier picture is replaced.")
out_option = option("--out", OUTPUT, "FILE", "File to write; an existing one is refused.")
jobs_option = option("--jobs", click.IntRange(min=1), "N", "Number of processes; default: one per processor.")
junit_option = option("--junit", OUTPUT, "FILE", "Write the verdicts as JUnit XML; replaces an earlier file.")
force_option = flag("--force", "Overwrite an existing file.")
configuration_argument = click.argument(
    "configuration", default="virtual", shell_complete=complete_configuration
)
_NAMED = ("configuration", "design", "robot", "what_if")
"""Parameters whose value is a file path or the name of a shipped file."""
FULL = frozenset({"scipy", "sympy", "flint", "matplotlib", "rich"})
"""Modules that the extra `full` installs."""
_RAN = 1
"""Exit code of a command that ran with a failure."""
REPORT_S = 20.0
"""Interval, s, of progress lines if there is no terminal."""
_REPORTED = frozenset({"run", "sim"})
"""Kinds of summaries after which `hil report` is recommended for the log."""


def finish(title: str, summary: dict[str, Any], shown: dict[str, Any] | None = None) -> NoReturn:
    """Write a summary to the file of --json, print it or `shown`, and exit with code 0 only on success."""
    from hil.app.output import show
    from hil.app.terminal import visible

    unwritten = write_twin(summary)
    if summary.get("trouble"):
        click.echo(visible(f"hil: {summary['trouble']}"), err=True)
    if summary.get("story"):
        for line in summary["story"]["lines"]:
            click.echo(visible(f"  {line}"), err=True)
    whole = click.get_current_context().params["verbose"]
    show(title, summary if shown is None else shown, whole=whole)
    if summary.get("kind") in _REPORTED and summary.get("log") and summary.get("ticks"):
        click.echo(f"next: hil report {shlex.quote(summary['log'])}")
    _end(summary, unwritten)


def finish_lines(lines: Iterable[str], summary: dict[str, Any]) -> NoReturn:
    """Write a summary to the file of --json, print the lines, and exit with code 0 only on success."""
    from hil.app.output import show_lines

    unwritten = write_twin(summary)
    show_lines(lines)
    _end(summary, unwritten)


def write_twin(summary: dict[str, Any]) -> list[str]:
    """Write the file of --json, first because printing may fail; return messages about unwritten files."""
    unwritten = list(summary.get("unwritten", ()))
    json_file = click.get_current_context().params["json_file"]
    if json_file is not None:
        from drivers.errors import LogError
        from hil.app.output import write_json

        try:
            write_json(json_file, summary)
        except LogError as error:
            unwritten.append(str(error))
    return unwritten


def _end(summary: dict[str, Any], unwritten: list[str]) -> NoReturn:
    if unwritten:
        from hil.app.terminal import one_line

        _refuse("\nhil: ".join(map(one_line, unwritten)), _RAN)
    sys.exit(0 if summary["success"] else _RAN)


def reporting(command: Callable[..., None]) -> Callable[..., None]:
    """Decorate a command: add the option --json, and check its output files before it begins."""

    @flag("-v --verbose", "Print all figures.")
    @option("--json json_file", OUTPUT, "FILE", "Also write the summary as JSON.")
    @wraps(command)
    def reporting(*args: Any, **kwargs: Any) -> None:
        _show_compilation()
        _refuse_same_files(kwargs)
        kwargs.pop("verbose")
        if (json_file := kwargs.pop("json_file")) is not None:
            from hil.app.output import check_json_path

            check_json_path(json_file)
        if kwargs.get("junit") is not None:
            from hil.study.junit import check_junit_path

            check_junit_path(kwargs["junit"])
        command(*args, **kwargs)

    return cast("Callable[..., None]", reporting)


def write(summary: dict[str, Any], out: Path | None, text: str) -> None:
    """Write `text` to the file `out`, if given; an error is stored in the summary, with exit code 1."""
    from hil.app.files import write_whole
    from hil.app.output import further

    if out is not None:
        with further(summary):
            write_whole(out, text)
            click.echo(f"written: {out}")


def write_cases(summary: dict[str, Any], junit: Path | None, name: str, cases: Iterable[Verdict]) -> None:
    """Write passed and failed cases as JUnit XML to `junit`, if given; an error is stored in the summary."""
    if junit is not None:
        from hil.app.output import further
        from hil.study.junit import write_junit

        with further(summary):
            write_junit(junit, name, cases, summary.get("wall_s"))


class OrOther(click.Command):
    """A command that runs one of `others` instead if its first argument is the name of that one."""

    others: tuple[click.Command, ...]

    def make_context(
        self, info_name: str | None, args: list[str], parent: click.Context | None = None, **extra: Any
    ) -> click.Context:
        """Context of the other command if the first argument is its name, else of this command."""
        for other in self.others:
            if args and args[0] == other.name:
                return other.make_context(f"{info_name} {args[0]}", args[1:], parent, **extra)
        return super().make_context(info_name, args, parent, **extra)


@contextmanager
def status(text: str) -> Iterator[Callable[[str], None]]:
    """Show an activity in a row of the terminal, if there is one; yield a function that changes the text."""
    from drivers.terminal_row import rewriting
    from hil.app.terminal import one_line

    def show(text: str) -> None:
        if sys.stderr.isatty():
            click.echo(rewriting(one_line(text), sys.stderr), err=True, nl=False)

    show(text)
    try:
        yield show
    finally:
        show("")


@contextmanager
def counted(text: str) -> Iterator[Callable[[int, int], None]]:
    """Show the progress of a batch: in a row of the terminal, without a terminal in a line every REPORT_S.

    Yields a function of the numbers of finished and of all jobs. Its first call sets the jobs done before.
    """
    begun = reported = time.monotonic()
    before: int | None = None

    def count(done: int, of: int) -> None:
        nonlocal reported, before
        now, before = time.monotonic(), done if before is None else before
        left = timedelta(seconds=round((now - begun) * (of - done) / max(done - before, 1)))
        line = f"{text}: {done} of {of}, {left} left"
        show(line)
        if not sys.stderr.isatty() and now - reported >= REPORT_S:
            reported = now
            click.echo(line, err=True)

    with status(text) as show:
        yield count


def _show_compilation() -> None:
    """Show the progress of a compilation on standard error: a row of the terminal, else one line."""
    from drivers.compiled import cache as kernels
    from drivers.terminal_row import rewriting

    numbers = itertools.count(1)

    def show(compiling: bool) -> None:
        number = next(numbers) if compiling else 0
        text = (
            f"compiling the mathematics, once: kernel {number}; about a minute of processor time; Ctrl-C "
            "keeps finished kernels ..."
        )
        if sys.stderr.isatty():
            click.echo(rewriting(text if compiling else "", sys.stderr), err=True, nl=False)
        elif number == 1:
            click.echo(text, err=True)

    kernels.progress = show


@contextmanager
def one_line_of_error() -> Iterator[None]:
    """Turn errors that a user can fix into one message and exit code 2."""
    from drivers.errors import HilError, LogError
    from hil.app.terminal import one_line

    try:
        yield
    except LogError as error:
        _refuse(one_line(str(error)))
    except HilError as error:
        _refuse(str(error))
    except ModuleNotFoundError as error:
        if error.name is None or error.name.partition(".")[0] not in FULL:
            raise
        _refuse(f"{error.name} is not installed: pip install 'hexapod-hil[full]'")
    except OSError as error:
        place = "" if error.filename is None else f"{error.filename}: "
        _refuse(f"{place}{error.strerror or error}")


def _refuse_same_files(arguments: dict[str, Any]) -> None:
    """Refuse an output that is also another file of the command. Raises LogError."""
    from drivers.errors import LogError
    from drivers.files import real_path

    seen: set[Path] = set()
    parameters = click.get_current_context().command.params
    for parameter in sorted(parameters, key=lambda each: isinstance(each.type, Output)):
        given = arguments.get(str(parameter.name))
        for each in given if isinstance(given, tuple) else (given,):
            if not (isinstance(each, Path) or (each and parameter.name in _NAMED)):
                continue
            file = real_path(Path(each))
            if file in seen and isinstance(parameter.type, Output):
                raise LogError(
                    f"{parameter.opts[0]} {each}: this command already uses that file; give another file"
                )
            seen.add(file)


def _refuse(message: str, code: int = 2) -> NoReturn:
    from hil.app.terminal import visible

    click.echo(visible(f"hil: {message}"), err=True)
    sys.exit(code)


def load(configuration: str, command: Literal["run", "plant", "sim"] | None = None) -> Configuration:
    """Load a configuration; for a command that moves the platform, check that the reference is reachable.

    Raises ConfigurationError.
    """
    from hil.app.configuration.configuration import load

    loaded = load(configuration)
    if command is not None:
        loaded.require(command)
        from hil.app.check.command import refuse_unreachable

        refuse_unreachable(loaded)
    return loaded
