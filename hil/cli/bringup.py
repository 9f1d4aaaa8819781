"""`hil bringup`."""

from typing import Any

import click

from hil.cli import shared
from hil.cli.interrupts import pressed


@click.command()
@shared.configuration_argument
@shared.flag("--rehearse", "On an emulated bench, in simulated time; nothing is moved.")
@shared.mistake_option
@shared.flag("--yes", "Agree to all steps, on a bench only.")
@shared.option("--state", shared.OUTPUT, "FILE", "Where the answers are kept between runs.")
@shared.flag("--again", "Measure everything again, whatever the state file holds.")
@shared.log_option
@shared.reporting
def command(configuration: str, rehearse: bool, mistakes: tuple[str, ...], **options: Any) -> None:
    """Bring a machine up, from parts to a moving platform, one leg at a time.

    Each step explains what it will do and how to stop it, and asks. Legs lie on trestles, without load, until
    the step `mounted`; at most one brake is open. Give the command again to go on. Ctrl-C at any moment, or a
    terminal that goes, takes force and power away. The configuration found and a checklist are written next
    to CONFIGURATION, never over it.

    \b
    Examples:
      hil bringup my.yaml                                             at the machine
      hil bringup virtual                                             with `hil plant virtual --bench`
      hil bringup virtual --rehearse --yes --mistake "ids_swapped leg=1 other=4"

    Guide: docs/guides/bringup.md.
    """
    if mistakes and not rehearse:
        raise click.UsageError(
            "--mistake is for a rehearsal: add --rehearse, or give it to `hil plant --bench`."
        )
    loaded = shared.load(configuration)
    from hil.lab.bringup.command import run_bringup
    from hil.loop.panel import signals_to

    with signals_to(pressed):  # a closed terminal leaves nothing under power
        rehearsed = mistakes if rehearse else None
        summary = run_bringup(configuration, loaded, mistakes=rehearsed, say=click.echo, **options)
    shared.finish("bringup", summary)
