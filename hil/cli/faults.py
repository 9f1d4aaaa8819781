"""`hil faults`."""

from pathlib import Path
from typing import Any

import click

from hil.cli import shared

SEED = "Draws leg, size and sign of each case; default: leg 2 and the usual sizes."


def _legs(_context: click.Context, _parameter: click.Parameter, value: str | None) -> tuple[int, ...]:
    """Return the legs of a list with commas, each once."""
    try:
        return tuple(dict.fromkeys(map(int, value.split(",") if value is not None else ())))
    except ValueError:
        raise click.BadParameter(f"{value}, allowed: numbers of legs with commas, as 0,3") from None


@click.command()
@shared.configuration_argument
@shared.option(
    "--only", str, "GLOB", "Cases by KIND or KIND/MOMENT, as 'brake_*'; repeatable.", multiple=True
)
@shared.option("--legs", str, "LEG,...", "Whose faults, where they are a leg's; default 2.", callback=_legs)
@shared.option("--seed", click.IntRange(min=0), "N", SEED)
@shared.jobs_option
@shared.junit_option
@shared.reporting
def command(configuration: str, junit: Path | None, **options: Any) -> None:
    """Inject each kind of fault once at each moment of a run, in simulated time, and judge what follows.

    The moments: LOADING, APPROACH, TRACKING where the reference is fastest, HOLD, PARKING, UNLOADING. A case
    passes if the run ends held within the bound of its kind and names a right cause and the leg, or if
    nothing came of the fault; where the sensors cannot see it, the error that it leaves is printed.

    \b
    Examples:
      hil faults lab --legs 0,3 --only 'brake_*' --only 'encoder_*/TRACKING'
      hil faults my.yaml --seed 7 --junit faults.xml

    Guide: docs/guides/faults.md.
    """
    loaded = shared.load(configuration, "sim")
    from hil.study.faults.command import run_matrix, show, shown, verdicts

    with shared.counted("injecting faults") as progress:
        summary = run_matrix(loaded, progress=progress, **options)
    show(summary)
    shared.write_cases(summary, junit, f"hil faults {summary['configuration']}", verdicts(summary))
    shared.finish("faults", summary, shown(summary))
