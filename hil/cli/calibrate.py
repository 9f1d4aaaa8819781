"""The command `hil calibrate`: its options and help text."""

from pathlib import Path

import click

from hil.cli import shared


@click.command()
@click.argument("configuration")
@click.argument("poses", type=shared.FILE)
@shared.option("--out", shared.OUTPUT, "FILE", "YAML file for the joints; an existing file is refused.")
@shared.reporting
def command(configuration: str, poses: Path, out: Path | None) -> None:
    """Fit joint positions and length offsets of CONFIGURATION to the measured pairs in POSES, a CSV file.

    Columns x_m,y_m,z_m,rx_deg,ry_deg,rz_deg (pose of the platform, rotation vector) and l1_m to l6_m (what
    the leg encoders read, in the order of the joint lists); optional standard deviations length_std_m,
    position_std_m, rotation_std_deg. At least 8 rows; about 30 are recommended, tilted and all over
    the workspace. Prints the uncertainty of each figure, and the figures that these poses cannot determine.
    CONFIGURATION is not changed.

    \b
    Examples:
      hil calibrate my.yaml poses.csv                      the report
      hil calibrate my.yaml poses.csv --out joints.yaml    and the joints, to copy into my.yaml

    Guide: docs/guides/parameters.md.
    """
    from hil.app.output import show_lines
    from hil.lab.calibrate.command import run_calibration

    report = run_calibration(configuration, poses, out)
    show_lines(report.lines)
    if out is None or "unwritten" in report.figures:
        click.echo(report.fragment, nl=False)
    shared.finish_lines((), {"success": True, "kind": "calibrate", **report.figures})
