"""The command `hil compare`: its options and help text."""

from pathlib import Path
from typing import Any

import click

from hil.cli import shared


def _names(context: click.Context, parameter: click.Parameter, value: str | None) -> tuple[str, ...] | None:
    if value is None:
        return None
    names = tuple(dict.fromkeys(name.strip() for name in value.split(",") if name.strip()))
    if not names:
        raise click.BadParameter("it contains no name of a law.", context, parameter)
    return names


PATHS = "Laws that also run with losses removed, `all` or `none`; default: CONFIGURATION's law."
WRENCH = "Load ON the platform at its origin, N and N m, base frame."
WRENCH_AT = "Time along the reference at which --wrench begins; default: 0."
FOLDER = click.Path(path_type=Path)


@click.command()
@shared.configuration_argument
@shared.option("--laws", str, "A,B", "Laws to compare; default: compare.laws, else all.", callback=_names)
@shared.option("--paths path_laws", str, "A,B", PATHS, callback=_names)
@shared.option("--duration duration_s", shared.DURATION, "S", "Stop after S s; default: one period.")
@shared.option(
    "--inertia-scale", shared.POSITIVE, "X", "Scale of the masses in the laws' models: 0.9 is 10 % too light."
)
@shared.option("--wrench", (shared.FiniteRange(),) * 6, "FX FY FZ MX MY MZ", WRENCH)
@shared.option("--wrench-at", shared.NOT_NEGATIVE, "S", WRENCH_AT)
@shared.flag("--lift-limits", "Run without the limits of tracking error, force change and speed.")
@shared.flag("--equal-crossover equal", "Scale the gains of all laws to one crossover.")
@shared.jobs_option
@shared.option("--picture", FOLDER, "FILE", "PNG file, or a folder for it; an earlier picture is replaced.")
@shared.reporting
def command(configuration: str, **options: Any) -> None:
    """Run all control laws on the platform, path, bus and drives of CONFIGURATION, in simulated time.

    Each law follows the reference and a step of 1 mm at home, with gains for the natural frequency and
    damping of the configuration's own law, or for the crossover of the first law with fixed gains, else of
    the first law (--equal-crossover). Prints crossover, delay margin, gains, errors, forces, step response,
    bandwidth, the error added by encoders, bus time and drive lag, and the claims of the control chapter. The
    picture goes to --picture, else to runs/NAME-compare-TIME.png (recording.folder).

    \b
    Examples:
      hil compare lab --laws pd,inverse_dynamics,printed --paths all
      hil compare virtual --inertia-scale 0.9 --wrench 0 0 -500 0 0 0 --wrench-at 0.5

    Guide: docs/guides/compare.md.
    """
    scale, wrench, at_s = (options.pop(name) for name in ("inertia_scale", "wrench", "wrench_at"))
    if at_s is not None and wrench is None:
        raise click.UsageError("--wrench-at is the time of --wrench: give both.")
    loaded = shared.load(configuration, "sim")
    from hil.study.compare import table
    from hil.study.compare.command import compare, with_options

    loaded = with_options(loaded, inertia_scale=scale, wrench=wrench, wrench_at_s=at_s or 0.0)
    with shared.counted("running the laws") as progress:
        summary = compare(loaded, progress=progress, **options)
    table.show(summary)
    shared.finish("compare", summary, table.shown(summary))
