"""`hil stability`."""

from math import nan
from typing import Any

import click

from hil.cli.shared import (
    NOT_NEGATIVE,
    FiniteRange,
    configuration_argument,
    finish_lines,
    load,
    option,
    reporting,
)
from hil.config.number import in_reason

Point = tuple[float, float, float]


def mass_at(_ctx: click.Context, _param: click.Parameter, value: str | None) -> tuple[float, Point] | None:
    """Return kg and m of `230kg@0.5,0.3,0.5`; without a place, of the origin. Raises BadParameter."""
    if value is None:
        return None
    mass, _, place = value.partition("@")
    try:
        kg = float(mass.strip().removesuffix("kg"))
        x, y, z = (float(part) for part in (place or "0,0,0").split(","))
    except ValueError:
        kg = x = y = z = nan
    if not (kg >= 0.0 and all(map(in_reason, (kg, x, y, z)))):
        raise click.BadParameter(f"{value!r}, allowed: a mass in kg and its place in m, as 230kg@0.5,0.3,0.5")
    return kg, (x, y, z)


@click.command()
@configuration_argument
@option(
    "--disturbance-force force_N",
    NOT_NEGATIVE,
    "N",
    "Unknown force on the platform, of any direction, changing as it likes.",
    default=0.0,
)
@option(
    "--disturbance-torque torque_N_m",
    NOT_NEGATIVE,
    "N_M",
    "Unknown torque about the platform's origin, likewise.",
    default=0.0,
)
@option(
    "--model-error",
    FiniteRange(min=0, max=1, max_open=True),
    "SHARE",
    "Masses and inertias that the law believes are wrong by this share, either way: 0.1 is 10 %.",
    default=0.0,
)
@option(
    "--payload",
    str,
    "KG@X,Y,Z",
    "A mass on the platform that the law does not know of, and its place in m: 230kg@0.5,0.3,0.5.",
    callback=mass_at,
)
@reporting
def command(configuration: str, payload: tuple[float, Point] | None, **options: Any) -> None:
    """Print what is proven of the law of CONFIGURATION, by which function, and under which conditions.

    The verdict is proven; conditional, if the listed conditions hold, which are not checked here; not proven,
    where no theorem applies; or unstable. Printed are eigenvalues and margins of the loop as it is sampled,
    held and late, and what the law's theorem gives: a bound of the error, or a boundary layer.

    \b
    Examples:
      hil stability                                      the default configuration
      hil stability virtual --disturbance-force 10000    and 10 kN that nobody measures
      hil stability virtual --payload 230kg@0.5,0.3,0.5  and a load that the law does not know
      hil stability my.yaml --disturbance-force 2000 --model-error 0.1 --json proof.json

    Guide: docs/theory/stability.md.
    """
    from hil.app.output import console

    loaded = load(configuration)
    from hil.app.stability.command import assess, shown
    from hil.app.stability.subject import NO_PAYLOAD, Payload

    with console.status("looking for a proof"):
        mass = NO_PAYLOAD if payload is None else Payload(*payload)
        summary = assess(loaded, payload=mass, **options)
    finish_lines(shown(summary), summary)
