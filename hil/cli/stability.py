"""`hil stability`."""

from math import nan
from typing import Any

import click

from hil.cli import shared
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


FORCE = "Unknown force on the platform, of any direction, changing as it likes."
TORQUE = "Unknown torque about the platform's origin, likewise."
SHARE = shared.FiniteRange(min=0, max=1, max_open=True)
MODEL = "Masses and inertias that the law believes are wrong by this share, either way: 0.1 is 10 %."
PAYLOAD = "A mass that the law does not know of, and its place in m: 230kg@0.5,0.3,0.5."


@click.command()
@shared.configuration_argument
@shared.option("--disturbance-force force_N", shared.NOT_NEGATIVE, "N", FORCE, default=0.0)
@shared.option("--disturbance-torque torque_N_m", shared.NOT_NEGATIVE, "N_M", TORQUE, default=0.0)
@shared.option("--model-error", SHARE, "SHARE", MODEL, default=0.0)
@shared.option("--payload", str, "KG@X,Y,Z", PAYLOAD, callback=mass_at)
@shared.reporting
def command(configuration: str, payload: tuple[float, Point] | None, **options: Any) -> None:
    """Print what is proven of the law of CONFIGURATION, by which function, and under which conditions.

    The verdict is proven; conditional, if the listed conditions hold, which are not checked here; not proven,
    where no theorem applies; or unstable. Printed are eigenvalues and margins of the loop as it is sampled,
    held and late, and what the law's theorem gives: a bound of the error, or a boundary layer.

    \b
    Examples:
      hil stability virtual --payload 230kg@0.5,0.3,0.5  and a load that the law does not know
      hil stability my.yaml --disturbance-force 2000 --model-error 0.1 --json proof.json

    Guide: docs/theory/stability.md.
    """
    loaded = shared.load(configuration)
    from hil.app.stability.command import assess, shown
    from hil.app.stability.subject import NO_PAYLOAD, Payload

    with shared.status("looking for a proof"):
        mass = NO_PAYLOAD if payload is None else Payload(*payload)
        summary = assess(loaded, payload=mass, **options)
    shared.finish_lines(shown(summary), summary)
