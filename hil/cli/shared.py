"""What the commands share: options, the way to end, the way to refuse. Heavy imports wait."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import click

if TYPE_CHECKING:
    from hil.app.configuration.configuration import Configuration


class FiniteRange(click.FloatRange):
    """A finite number within a range; click's own lets nan through, which is in no order to its ends."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Return the number; refuse what is none, not finite or out of range."""
        number: float = super().convert(value, param, ctx)
        if not math.isfinite(number):
            self.fail(f"{value!r} is not a finite number.", param, ctx)
        return number


FILE = click.Path(dir_okay=False, path_type=Path)
json_option = click.option(
    "--json", "json_file", type=FILE, metavar="FILE", help="Write the summary there as JSON, too."
)
log_option = click.option(
    "--log", type=FILE, metavar="FILE", help="Log file to write; an existing one is refused."
)
duration_option = click.option(
    "--duration", type=FiniteRange(min=0, min_open=True), metavar="S", help="Stop after S seconds."
)
configuration_argument = click.argument("configuration", default="virtual")


def finish(
    title: str, summary: dict[str, Any], json_file: Path | None, shown: dict[str, Any] | None = None
) -> None:
    """Print a summary (`shown`, where that says it better), write its JSON twin, exit 0 only on success."""
    from hil.app.output import show, write_json

    show(title, summary if shown is None else shown)
    if json_file is not None:
        write_json(json_file, summary)
    sys.exit(0 if summary["success"] else 1)


def guarded(command: Callable[..., None]) -> Callable[..., None]:
    """Turn errors that a user can mend into one message and exit code 2; check the output files first."""

    @wraps(command)
    def guarded(*args: Any, **kwargs: Any) -> None:
        from drivers.errors import HilError

        try:
            if kwargs["json_file"] is not None:
                from hil.app.output import check_json_path

                check_json_path(kwargs["json_file"], *_other_files(kwargs))
            command(*args, **kwargs)
        except HilError as error:
            _refuse(str(error))
        except OSError as error:
            place = "" if error.filename is None else f"{error.filename}: "
            _refuse(f"{place}{error.strerror or error}")

    return guarded


def _other_files(arguments: dict[str, Any]) -> list[Path]:
    given = (arguments.get(name) for name in ("configuration", "log", "salvage", "picture", "model"))
    return [Path(file) for file in given if file is not None]


def _refuse(message: str) -> None:
    click.echo(f"hil: {message}", err=True)
    sys.exit(2)


def announce_compilation() -> None:
    """Say why the first start takes so long."""
    from drivers.compiled.compiler import FIRST_COMPILATION

    if FIRST_COMPILATION:
        click.echo("compiling the mathematics, once (about 45 s) ...", err=True)


def load(configuration: str, command: Literal["run", "plant", "sim"]) -> Configuration:
    """Load a configuration and refuse what cannot work, before anything starts.

    Raises ConfigurationError.
    """
    from hil.app.configuration.configuration import load

    loaded = load(configuration)
    loaded.require(command)
    announce_compilation()
    from hil.app.check.command import refuse_unreachable

    refuse_unreachable(loaded)
    return loaded
