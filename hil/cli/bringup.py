"""The command `hil bringup`: its options and help text."""

from typing import Any

import click

from hil.cli import shared
from hil.cli.interrupts import pressed


@click.command()
@shared.configuration_argument
@shared.flag("--rehearse", "Rehearse on an emulated bench, in simulated time; nothing moves.")
@shared.mistake_option
@shared.flag("--yes", "Confirm all steps; on an emulated bench only.")
@shared.option("--state", shared.OUTPUT, "FILE", "File that keeps the answers between runs.")
@shared.flag("--again", "Measure everything again and ignore the state file.")
@shared.log_option
@shared.reporting
def command(configuration: str, rehearse: bool, mistakes: tuple[str, ...], **options: Any) -> None:
    """Commission a machine, from parts to a moving platform, one leg at a time.

    Each step explains what it will do and how to stop it, and asks for confirmation. Until the step `mounted`
    the legs lie on trestles, without load; at most one brake is open. Repeat the command to continue after a
    break. Ctrl-C at any moment, or a closed terminal, switches force and power off. The resulting
    configuration and a checklist are written next to CONFIGURATION, never over it.

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
