"""`hil workspace`."""

from typing import Any

import click

from hil.cli.shared import (
    NOT_NEGATIVE,
    POSITIVE,
    configuration_argument,
    finish,
    load,
    option,
    picture_option,
    reporting,
)


@click.command()
@configuration_argument
@option(
    "--resolution",
    click.IntRange(8, 160),
    "N",
    "Steps of the grid along the longest side of the workspace.",
    default=60,
    show_default=True,
)
@option(
    "--position",
    (float, float, float),
    "X Y Z",
    "Where to map orientations, m in the base frame; default: home.",
)
@option(
    "--payload payload_kg",
    NOT_NEGATIVE,
    "KG",
    "Further mass on the platform, for the static leg forces.",
    default=0.0,
)
@option(
    "--payload-at",
    (float, float, float),
    "X Y Z",
    "Its centre of mass, m in the platform frame; default: the origin.",
    default=(0.0, 0.0, 0.0),
)
@option("--leg-diameter leg_diameter_m", POSITIVE, "M", "Look at collisions of legs this thick, too.")
@picture_option
@reporting
def command(configuration: str, **options: Any) -> None:
    """Map the poses that the platform can reach from home within stroke, joint angle and force limits.

    Volume, extents, sections, the largest sphere and cylinder at home's orientation; tilt and torsion at one
    position; condition number and static leg forces. What lies behind a singularity or a gap does not count.
    The picture goes to --picture, else to runs/NAME-workspace-TIME.png (recording.folder).

    \b
    Examples:
      hil workspace                         the default configuration
      hil workspace lab --picture lab.png --json lab.json
      hil workspace lab --payload 200 --position 0 0 0.9
      hil workspace my.yaml --resolution 120 --leg-diameter 0.08

    Guide: docs/guides/workspace.md.
    """
    from hil.app.output import console

    loaded = load(configuration)
    from hil.study.workspace.command import map_workspace, shown

    with console.status("mapping") as status:
        summary = map_workspace(loaded, progress=lambda what: status.update(f"mapping: {what}"), **options)
    finish("workspace", summary, shown(summary))
