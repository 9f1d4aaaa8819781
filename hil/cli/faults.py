"""`hil faults`."""

from pathlib import Path
from typing import Any

import click

from hil.cli.shared import (
    configuration_argument,
    counted,
    finish,
    jobs_option,
    junit_option,
    load,
    option,
    reporting,
    write_cases,
)


def _legs(text: str | None) -> tuple[int, ...]:
    """Return the legs of a list with commas, each once. Raises ConfigurationError for what is none."""
    from drivers.errors import ConfigurationError

    words = [] if text is None else text.split(",")
    try:
        return tuple(dict.fromkeys(map(int, words)))
    except ValueError:
        raise ConfigurationError(f"--legs {text}: allowed: numbers of legs with commas, as 0,3") from None


@click.command()
@configuration_argument
@option("--only", str, "GLOB", "Cases by KIND or KIND/MOMENT, as 'brake_*'; may be repeated.", multiple=True)
@option("--legs", str, "LEG,...", "Whose faults, where they are a leg's: each once; default 2.")
@option(
    "--seed",
    click.IntRange(min=0),
    "N",
    "Draws leg, size and sign of each case; default: leg 2 and the usual sizes.",
)
@jobs_option
@junit_option
@reporting
def command(configuration: str, legs: str | None, junit: Path | None, **options: Any) -> None:
    """Inject each kind of fault once at each moment of a run, in simulated time, and judge what follows.

    The moments: LOADING, APPROACH, TRACKING where the reference is fastest, HOLD, PARKING, UNLOADING. A case
    passes if the run ends held within the bound of its kind and names a right cause and the leg, or if
    nothing came of the fault; where the sensors cannot see it, the error that it leaves is printed.

    \b
    Examples:
      hil faults                            the default configuration
      hil faults lab --legs 0,3 --only 'brake_*' --only 'encoder_*/TRACKING'
      hil faults --seed 7                   other legs, sizes and signs, the same each time
      hil faults my.yaml --jobs 4 --junit faults.xml --json faults.json

    Guide: docs/guides/faults.md.
    """
    loaded = load(configuration, "sim")
    from hil.study.faults.command import run_matrix, show, shown, verdicts

    with counted("injecting faults") as progress:
        summary = run_matrix(loaded, legs=_legs(legs), progress=progress, **options)
    show(summary)
    write_cases(summary, junit, f"hil faults {summary['configuration']}", verdicts(summary))
    finish("faults", summary, shown(summary))
