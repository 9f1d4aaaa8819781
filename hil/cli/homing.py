"""The command `hil homing`: its options and help text."""

from typing import Any

import click

from hil.cli import shared

LEG = (click.IntRange(0, 5), float)
ONE = "Length of this leg; the others keep their lengths in the file. May be repeated."


@click.command()
@shared.configuration_argument
@shared.flag("--at-home", "The platform is at platform.home.")
@shared.option("--lengths lengths_m", (float,) * 6, "M M M M M M", "Lengths of the legs, joint to joint.")
@shared.option("--leg legs", LEG, "LEG M", ONE, multiple=True)
@shared.flag("--emulated", "Show or set the file of the emulated drives instead: plant.homing_file.")
@shared.reporting
def command(configuration: str, legs: tuple[tuple[int, float], ...], **options: Any) -> None:
    """Show or set the parked leg lengths, for motors that lose their turn count at power-off.

    A run that ends at rest writes drives.homing.file, from which the next run restores all turn counts. A run
    is not armed if a leg is found elsewhere, or after a run that was killed in motion. Then measure the legs
    and set their lengths in m, in leg order, to a quarter of the travel that a drive loses. Nothing moves.

    \b
    Examples:
      hil homing my.yaml --at-home                        the platform rests at platform.home
      hil homing my.yaml --leg 2 0.3127                   only leg 2 was moved by hand
      hil homing my.yaml --lengths .31 .31 .32 .32 .31 .31

    Guide: docs/guides/drives.md.
    """
    if options["at_home"] and options["lengths_m"] is not None:
        raise click.UsageError("--at-home and --lengths contradict each other: give one of them")
    loaded = shared.load(configuration)
    from hil.app.homing.command import state_homing

    shared.finish("homing", state_homing(loaded, legs_m=dict(legs), **options))
