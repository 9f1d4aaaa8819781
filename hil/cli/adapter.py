"""The command `hil adapter`: its options and help text."""

from pathlib import Path

import click

from hil.cli import shared


@click.command()
@click.argument("configuration", metavar="CONFIG|IFACE", shell_complete=shared.complete_configuration)
@shared.option("--channel", str, "NAME", "Bus of a configuration with several; default: the first.")
@shared.option("--receiver", str, "NAME", "Second interface on the same bus, which receives.")
@shared.option("--duration duration_s", shared.DURATION, "S", "Time at loop.rate_Hz.", default=10.0)
@shared.reporting
def command(configuration: str, channel: str | None, receiver: str | None, duration_s: float) -> None:
    """Measure a CAN interface before it is trusted: latency, loss, queue, time stamps, recovery.

    Sends the frames of a tick at the rate of the loop, as zeros with identifiers to which no drive listens.
    Refuses to send, without exception, on a bus that carries frames of others: power the drives off. The
    frames come back to the same interface, or with --receiver to another one on the bus. Writes
    adapter-NAME.yaml next to the configuration; `hil check` budgets with it, `hil run` warns of another
    adapter. A network interface in place of a configuration is measured with the frames and the rate of
    `socketcan`. Takes the interface down and up once if permitted.

    \b
    Examples:
      hil adapter my.yaml
      hil adapter my.yaml --receiver can1
      hil adapter can0

    Guide: docs/guides/adapters.md.
    """
    from hil.app.adapter.measure import of_interface, qualify

    there = Path("/sys/class/net", configuration).exists() and not Path(configuration).is_file()
    c = of_interface(configuration) if there else shared.load(configuration)
    with shared.counted("frames and ticks") as tell:
        lines, summary = qualify(c, channel=channel, receiver=receiver, duration_s=duration_s, tell=tell)
    shared.finish_lines(lines, summary)
