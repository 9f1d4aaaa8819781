"""The command `hil setpoint`: its options and help text."""

import sys

import click

from hil.cli import shared


@click.command()
@shared.configuration_argument
@shared.option("--position", (float,) * 3, "X Y Z", "Position of the platform, m.")
@shared.option(
    "--rotation", (float,) * 3, "RX RY RZ", "Rotation vector, deg; with --position; default 0 0 0."
)
@shared.reporting
def command(
    configuration: str,
    position: tuple[float, float, float] | None,
    rotation: tuple[float, float, float] | None,
) -> None:
    """Send set-points to a running `hil run CONFIG` whose reference is of type live.

    Without --position every line of the standard input is a set-point: x y z in m, then the rotation vector
    in deg. The controller moves there within reference.limits, and reports whether it accepted the set-point.
    It refuses poses out of stroke, too close to a singularity or with forces over limits.force_N.

    \b
    Examples:
      hil setpoint my.yaml --position 0 0 1 --rotation 0 5 10
      hil setpoint my.yaml                  a set-point per typed line, until Ctrl-D

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
        shared.load(configuration).require_live()
    shared.finish("setpoint", send_setpoints(controller.bus, lines))
