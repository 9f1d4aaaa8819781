"""The command `hil workspace`: its options and help text."""

from typing import Any

import click

from hil.cli import shared

XYZ = (float, float, float)
PAYLOAD_AT = "Centre of mass of --payload, m in the platform frame; default: the origin."


@click.command()
@shared.configuration_argument
@shared.option("--resolution", click.IntRange(8, 160), "N", "Steps along the longest side.", default=60)
@shared.option("--position", XYZ, "X Y Z", "Where to map orientations, m in the base frame; default: home.")
@shared.option(
    "--payload payload_kg", shared.NOT_NEGATIVE, "KG", "Additional mass on the platform.", default=0.0
)
@shared.option("--payload-at", XYZ, "X Y Z", PAYLOAD_AT, default=(0.0, 0.0, 0.0))
@shared.option("--leg-diameter leg_diameter_m", shared.POSITIVE, "M", "Check collisions of legs this thick.")
@shared.picture_option
@shared.reporting
def command(configuration: str, **options: Any) -> None:
    """Map the poses that the platform can reach from home within stroke, joint angle and force limits.

    Volume, extents, sections, the largest sphere and cylinder at home's orientation; tilt and torsion at one
    position; condition number and static leg forces. Poses beyond a singularity or a gap do not count.
    The picture goes to --picture, else to runs/NAME-workspace-TIME.png (recording.folder).

    \b
    Examples:
      hil workspace lab --payload 200 --position 0 0 0.9 --picture lab.png
      hil workspace my.yaml --resolution 120 --leg-diameter 0.08

    Guide: docs/guides/workspace.md.
    """
    loaded = shared.load(configuration)
    from hil.study.workspace.command import map_workspace, shown

    with shared.status("mapping") as progress:
        summary = map_workspace(loaded, progress=lambda what: progress(f"mapping: {what}"), **options)
    shared.finish("workspace", summary, shown(summary))
