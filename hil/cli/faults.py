"""The command `hil faults`: its options and help text."""

from pathlib import Path
from typing import Any

import click

from hil.cli import shared

SEED = "Random seed of leg, size and sign of each case; default: leg 2 and the usual sizes."


def _legs(_context: click.Context, _parameter: click.Parameter, value: str | None) -> tuple[int, ...]:
    """Parse leg numbers separated by commas; repeated numbers count once."""
    try:
        return tuple(dict.fromkeys(map(int, value.split(",") if value is not None else ())))
    except ValueError:
        raise click.BadParameter(f"{value}, allowed: leg numbers with commas, as 0,3") from None


@click.command()
@shared.configuration_argument
@shared.option(
    "--only", str, "GLOB", "Cases by KIND or KIND/MOMENT, as 'brake_*'; repeatable.", multiple=True
)
@shared.option("--legs", str, "LEG,...", "Legs for the kinds that affect one leg; default 2.", callback=_legs)
@shared.option("--seed", click.IntRange(min=0), "N", SEED)
@shared.jobs_option
@shared.junit_option
@shared.reporting
def command(configuration: str, junit: Path | None, **options: Any) -> None:
    """Inject each kind of fault once at each moment of a run, in simulated time, and judge the reaction.

    The moments: LOADING, APPROACH, TRACKING where the reference is fastest, HOLD, PARKING, UNLOADING. A case
    passes if the platform is held within the bound of its kind and the run reports a correct cause and the
    leg, or if the fault has no effect. If the sensors cannot detect it, the remaining error is printed.

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
