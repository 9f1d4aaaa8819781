"""The command `hil bus`: its options and help text."""

from pathlib import Path

import click

from hil.cli import shared

COUNT = click.IntRange(min=1)


@click.command()
@click.argument("fmus", nargs=-1, required=True)
@shared.option("--interface", click.Choice(["localcan", "socketcan"]), None, "CAN interface, in real time.")
@shared.option("--channel", str, "NAME", "Channel of the interface.", default="hil0", show_default=True)
@shared.duration_option
@shared.option("--bitrate", COUNT, "BIT/S", "Bit rate if no FMU configures one.", default=1_000_000)
@shared.option("--data-bitrate", COUNT, "BIT/S", "Likewise for the data phase.", default=5_000_000)
@shared.flag("--classic", "Classic CAN interface, without CAN FD.")
@shared.option("--step-us", COUNT, "US", "Communication step of the FMUs.", default=1000, show_default=True)
@shared.option("--error-every", COUNT, "N", "Lockstep: destroy each N-th frame with a CRC error.")
@shared.option("--log", shared.OUTPUT, "FILE", "Lockstep: frames in the format of candump.")
@shared.reporting
def command(
    fmus: tuple[str, ...],
    interface: str | None,
    channel: str,
    duration_s: float | None,
    bitrate: int,
    data_bitrate: int,
    classic: bool,
    step_us: int,
    error_every: int | None,
    log: Path | None,
) -> None:
    """Put CAN FMUs (FMI-LS-BUS 1.0) on one CAN bus.

    Without --interface the bus is simulated in lockstep: deterministic, with bit time and arbitration. With
    --interface the FMUs run in real time on that bus, next to all others there. FILE.fmu:TERMINAL chooses one
    of several CAN terminals. The duration is 1 s unless --duration says another.

    \b
    Examples:
      hil bus drive.fmu ecu.fmu --duration 10 --log frames.log
      hil bus ecu.fmu --interface localcan --channel hil0 --duration 60

    Guide: docs/guides/can-fmus.md.
    """
    from drivers.can.bus_time import BitTiming
    from hil.app.bus import run_attached, run_lockstep

    timing, duration_s = BitTiming(bitrate, data_bitrate), duration_s or 1.0
    if interface is None and classic:
        raise click.UsageError("--classic is for a bus in real time: add --interface.")
    if interface is None:
        summary = run_lockstep(fmus, timing, step_us, duration_s, error_every=error_every or 0, log=log)
    elif error_every or log:
        raise click.UsageError("--error-every and --log are for the bus in lockstep: leave out --interface.")
    else:
        summary = run_attached(
            fmus, timing, step_us, duration_s, interface=interface, channel=channel, fd=not classic
        )
    shared.finish("bus", summary)
