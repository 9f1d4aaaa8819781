"""The command line: a table over hil.app, one file a command."""

from __future__ import annotations

import os

import click

from hil.cli.calibrate import calibrate_command
from hil.cli.check import check_command
from hil.cli.compare import compare_command
from hil.cli.design import design_group
from hil.cli.fmu import fmu_group
from hil.cli.identify import identify_command
from hil.cli.plant import plant_command
from hil.cli.replay import replay_command
from hil.cli.run import run_command
from hil.cli.setpoint import setpoint_command
from hil.cli.sim import sim_command
from hil.cli.stability import stability_command
from hil.cli.workspace import workspace_command

# Before anything imports NumPy: the threads of its BLAS, which no loop uses, would spin beside the loop.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


class _InOrder(click.Group):
    """Lists its commands in the order in which they were added."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        del ctx
        return list(self.commands)


@click.group(cls=_InOrder, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(package_name="hexapod-hil", prog_name="hil")
def main() -> None:
    """Hardware-in-the-loop bridge for six-legged parallel robots on CAN.

    \b
    First steps, nothing but this machine needed:
      hil check              figures and problems of a configuration, nothing moves
      hil stability          what is proven of the law, with bounds of the error
      hil workspace          map of the reachable poses, with a picture
      hil compare            all control laws on this platform, path, bus and drives
      hil sim                controller, bus, drives and platform in simulated time
      hil run --plant        the same in real time, the platform's FMU behind the bus
      hil replay LOG         a recorded run again, compared to the bit

    CONFIG is a YAML file or the name of a shipped one: virtual (the default), ideal,
    socketcan, lab, bench, vcan50. Logs are MCAP files; without --log they go into the
    folder recording.folder of the configuration, `runs`, under the name and the time.
    No log is ever overwritten.

    \b
    Exit codes of every command:
      0  success
      1  it ran, and something was wrong; the summary says what
      2  refused before anything moved; the message says why and what is allowed
    """


for command in (
    run_command,
    plant_command,
    sim_command,
    replay_command,
    check_command,
    stability_command,
    setpoint_command,
    workspace_command,
    compare_command,
    fmu_group,
    calibrate_command,
    identify_command,
    design_group,
):
    main.add_command(command)

__all__ = ["main"]
