"""The command `hil stability`: its options and help text."""

from math import nan
from typing import Any

import click

from hil.cli import shared
from hil.config.number import is_allowed

Point = tuple[float, float, float]


def mass_at(_ctx: click.Context, _param: click.Parameter, value: str | None) -> tuple[float, Point] | None:
    """Parse a mass, kg, and its place, m, as `230kg@0.5,0.3,0.5`; default place: the platform's origin."""
    if value is None:
        return None
    mass, _, place = value.partition("@")
    try:
        kg = float(mass.strip().removesuffix("kg"))
        x, y, z = (float(part) for part in (place or "0,0,0").split(","))
    except ValueError:
        kg = x = y = z = nan
    if not (kg >= 0.0 and all(map(is_allowed, (kg, x, y, z)))):
        raise click.BadParameter(f"{value!r}, allowed: a mass in kg and its place in m, as 230kg@0.5,0.3,0.5")
    return kg, (x, y, z)


FORCE = "Largest unknown force on the platform, in any direction, varying arbitrarily."
TORQUE = "Largest unknown torque about the platform's origin, varying arbitrarily."
SHARE = shared.FiniteRange(min=0, max=1, max_open=True)
MODEL = "Relative error of masses and inertias in the law's model, either sign: 0.1 is 10 %."
PAYLOAD = "Mass unknown to the law, and its place in m: 230kg@0.5,0.3,0.5."


@click.command()
@shared.configuration_argument
@shared.option("--disturbance-force force_N", shared.NOT_NEGATIVE, "N", FORCE, default=0.0)
@shared.option("--disturbance-torque torque_N_m", shared.NOT_NEGATIVE, "N_M", TORQUE, default=0.0)
@shared.option("--model-error", SHARE, "SHARE", MODEL, default=0.0)
@shared.option("--payload", str, "KG@X,Y,Z", PAYLOAD, callback=mass_at)
@shared.reporting
def command(configuration: str, payload: tuple[float, Point] | None, **options: Any) -> None:
    """Print what is proven about the control law of CONFIGURATION, by which function, under which conditions.

    The verdict is proven; conditional, with a list of conditions that are not checked here; not proven, if no
    theorem applies; or unstable. Prints eigenvalues and margins of the loop with its sampling, hold and
    delay, and the result of the law's theorem: a bound of the error, or a boundary layer.

    \b
    Examples:
      hil stability virtual --payload 230kg@0.5,0.3,0.5  with a load that the law does not know
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
