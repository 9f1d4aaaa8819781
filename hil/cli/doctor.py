"""The command `hil doctor`: its options and help text."""

import click

from hil.cli import shared


@click.command()
@shared.configuration_argument
@shared.reporting
def command(configuration: str) -> None:
    """List what of this machine's set-up endangers a run of CONFIGURATION, with the command for each.

    Scheduler rights, kernel, clock source, CPU clock and sleep, isolated CPUs, interrupts, the CAN
    interfaces of the configuration, disk. Only what matters at loop.rate_Hz is listed. Nothing is changed.

    \b
    Examples:
      hil doctor                for the default configuration, 1 kHz
      hil doctor my.yaml

    Guide: docs/guides/machine.md.
    """
    from hil.app.doctor import examine

    shared.finish_lines(*examine(shared.load(configuration)))
