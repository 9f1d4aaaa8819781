"""`hil homing`."""

from typing import Any

import click

from hil.cli import shared

LEG = (click.IntRange(0, 5), float)
ONE = "This leg has this length; the others stay as the file has them. May be repeated."


@click.command()
@shared.configuration_argument
@shared.flag("--at-home", "The platform is at platform.home.")
@shared.option("--lengths lengths_m", (float,) * 6, "M M M M M M", "Lengths of the legs, joint to joint.")
@shared.option("--leg legs", LEG, "LEG M", ONE, multiple=True)
@shared.flag("--emulated", "Of the emulated drives: plant.homing_file.")
@shared.reporting
def command(configuration: str, legs: tuple[tuple[int, float], ...], **options: Any) -> None:
    """Show where the legs were parked, or state where they stand; for motors that forget their turns.

    A run writes drives.homing.file when it ends at rest, and the next one finds each motor's turn by it. It
    is not armed where a leg is found elsewhere, nor after a run that was killed in motion. Then measure the
    legs and state their lengths in m, in leg order, to a quarter of what a drive forgets. Nothing moves.

    \b
    Examples:
      hil homing my.yaml --at-home                        the platform rests at platform.home
      hil homing my.yaml --leg 2 0.3127                   leg 2 was moved by hand, the others were not
      hil homing my.yaml --lengths .31 .31 .32 .32 .31 .31

    Guide: docs/guides/drives.md.
    """
    if options["at_home"] and options["lengths_m"] is not None:
        raise click.UsageError("--at-home and --lengths contradict each other: give one of them")
    loaded = shared.load(configuration)
    from hil.app.homing.command import state_homing

    shared.finish("homing", state_homing(loaded, legs_m=dict(legs), **options))
