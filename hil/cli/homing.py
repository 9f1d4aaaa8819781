"""`hil homing`."""

from pathlib import Path

import click

from hil.cli.shared import configuration_argument, finish_briefly, load, reporting


@click.command()
@configuration_argument
@click.option("--at-home", is_flag=True, help="The platform is at platform.home.")
@click.option(
    "--lengths",
    type=(float,) * 6,
    metavar="M M M M M M",
    help="The legs have these lengths, m, joint centre to joint centre, leg order.",
)
@click.option(
    "--leg",
    "legs",
    type=(click.IntRange(0, 5), float),
    multiple=True,
    metavar="LEG M",
    help="This leg has this length; the others stay as the file has them. May be repeated.",
)
@click.option("--emulated", is_flag=True, help="Of the emulated drives: plant.homing_file.")
@reporting
def command(
    configuration: str,
    at_home: bool,
    lengths: tuple[float, ...] | None,
    legs: tuple[tuple[int, float], ...],
    emulated: bool,
    json_file: Path | None,
) -> None:
    """Show where the legs were parked, or state where they stand; for motors that forget their turns.

    A run writes drives.homing.file when it ends at rest, and the next one finds each motor's turn by it. It
    is not armed where a leg is found elsewhere, nor after a run that was killed in motion. Then measure the
    legs and state their lengths: nearer than a quarter of what a drive forgets, the encoder knows the rest.
    Nothing moves, and no bus is opened.

    \b
    Examples:
      hil homing my.yaml                                  show the file
      hil homing my.yaml --at-home                        the platform rests at platform.home
      hil homing my.yaml --leg 2 0.3127                   leg 2 was moved by hand, the others were not
      hil homing my.yaml --lengths .31 .31 .32 .32 .31 .31

    Guide: docs/guides/drives.md.
    """
    if at_home and lengths is not None:
        raise click.UsageError("--at-home and --lengths contradict each other: give one of them")
    loaded = load(configuration)
    from hil.app.homing.command import state_homing

    summary = state_homing(
        loaded, emulated=emulated, at_home=at_home, lengths_m=lengths or (), legs_m=dict(legs)
    )
    finish_briefly("homing", summary, json_file)
