"""The command `hil lengths`."""

from __future__ import annotations

import click

from hil.app.configuration.configuration import load
from hil.app.configuration.platform import build_platform, pose_arrays
from hil.cli.shared import configuration_argument
from hil.kinematics import leg_lengths


@click.command()
@configuration_argument
def command(configuration: str) -> None:
    """Print the leg lengths at home, m."""
    section = load(configuration).platform
    lengths = leg_lengths(build_platform(section), *pose_arrays(section.home))
    click.echo(" ".join(f"{length:.3f}" for length in lengths))
