"""The command `hil sim`: its options and help text."""

from pathlib import Path
from typing import Any

import click

from hil.cli import shared

SETPOINTS = "CSV of poses for a live reference: t_s,x_m,y_m,z_m,rx_deg,ry_deg,rz_deg."
COMMANDS = "Operator commands: lines with a simulated time in s and a word of `hil ctl`, as `2.5 hold`."


@click.command()
@shared.configuration_argument
@shared.duration_option
@shared.log_option
@shared.fault_option
@shared.option("--setpoints", shared.FILE, "FILE", SETPOINTS)
@shared.option("--commands", shared.FILE, "FILE", COMMANDS)
@shared.flag("--plant-log", "Also record the plant's true values, as NAME-plant.mcap next to the log.")
@shared.reporting
def command(configuration: str, faults: tuple[str, ...], commands: Path | None, **options: Any) -> None:
    """Run both ends of the bus in lockstep, in simulated time, as fast as the machine can.

    Deterministic: the same configuration gives the same frames and rows, byte for byte. Frames take their
    worst-case bit time. `--duration` stops along the path at S simulated seconds and parks. Without
    `--commands` the run never waits for an operator, whatever section `operator` requires. The log goes to
    --log, else to runs/NAME-TIME.mcap (recording.folder), and is replayed at the end.

    \b
    Examples:
      hil sim my.yaml --setpoints poses.csv --commands operator.txt --duration 10
      hil sim virtual --duration 2 --fault "brake_stuck_open leg=3 mode=PARKING"

    Guide: docs/guides/first-run.md.
    """
    loaded = shared.load(configuration, "sim")
    from hil.app.check.warnings import falls
    from hil.app.configuration.fault_words import with_faults
    from hil.app.output import warn
    from hil.app.sim.command import simulate
    from hil.app.sim.commands import read_commands

    loaded = with_faults(loaded, faults)
    if danger := falls(loaded):
        warn(f"hil: {danger}")
    orders = () if commands is None else read_commands(commands)
    shared.finish("sim", simulate(loaded, live=True, commands=orders, **options))
