"""`hil setpoint`."""

import sys

import click

from hil.cli.shared import configuration_argument, finish_briefly, option, reporting


@click.command()
@configuration_argument
@option("--position", float, "X Y Z", "Where to go, m.", nargs=3)
@option("--rotation", float, "RX RY RZ", "Rotation vector, deg; with --position.  [default: 0 0 0]", nargs=3)
@reporting
def command(
    configuration: str,
    position: tuple[float, float, float] | None,
    rotation: tuple[float, float, float] | None,
) -> None:
    """Send set-points to a running `hil run CONFIG` whose reference is of type live.

    Without --position every line of the standard input is one: x y z in m and, after them, the rotation
    vector in deg. The controller moves there within reference.limits, and answers whether it took the
    set-point: out of stroke, too near to a singularity or beyond the force it refuses it.

    \b
    Examples:
      hil setpoint my.yaml --position 0 0 1 --rotation 0 5 10
      hil setpoint my.yaml                  one for each line typed, until Ctrl-D

    Guide: docs/guides/references.md.
    """
    from hil.app.configuration.address import address
    from hil.app.operate import send_setpoints

    if position is None and rotation is not None:
        raise click.UsageError("--rotation needs --position: a set-point is a whole pose")
    pose = (*(position or ()), *(rotation or ()))
    lines = [" ".join(map(repr, pose))] if pose else sys.stdin
    controller = address(configuration)
    if not controller.live:
        from hil.app.configuration.configuration import load

        load(configuration).require_live()
    finish_briefly("setpoint", send_setpoints(controller.bus, lines))
