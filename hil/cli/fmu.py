"""`hil fmu`."""

from pathlib import Path
from typing import Literal

import click

from hil.cli.shared import FILE, finish, finish_lines, option, reporting


@click.group()
def command() -> None:
    """Build the platform's FMU, for this project and for any other tool; look at an FMU of your own.

    `hil run --plant`, `hil plant` and `hil sim` build it by themselves when it is needed.
    """


@command.command("build", short_help="Compile the platform's physics into FMUs.")
@option(
    "--fmi",
    click.Choice(["2.0", "3.0", "both"]),
    None,
    "FMI version of the interface; the physics is the same.",
    default="both",
    show_default=True,
)
@option("--output", click.Path(file_okay=False, path_type=Path), "FOLDER", "Copy the .fmu there.")
@reporting
def fmu_build_command(fmi: Literal["2.0", "3.0", "both"], output: Path | None) -> None:
    """Compile the platform's physics into FMUs for co-simulation (system `cc`, else ziglang).

    One FMU serves every platform: geometry and inertia are its parameters. It stays in the user's cache.

    \b
    Examples:
      hil fmu build                         both versions, into the cache
      hil fmu build --fmi 3.0 --output .    ./stewart-fmi3.fmu for another tool

    Guide: docs/guides/own-fmu.md.
    """
    from hil.app.fmu import build_fmus

    if output is not None:
        output.mkdir(parents=True, exist_ok=True)
    finish("fmu build", build_fmus(fmi, output))


@command.command("show", short_help="Variables of an FMU, and a proposal how to map them.")
@click.argument("fmu", type=FILE)
@reporting
def fmu_show_command(fmu: Path) -> None:
    """List inputs, outputs and parameters of FMU with their units, and propose section `plant.model`.

    Only its description is read. `hil check` on a configuration with it pushes each leg once.

    \b
    Examples:
      hil fmu show my_robot.fmu
      hil fmu show my_robot.fmu --json my-map.json

    Guide: docs/guides/own-fmu.md.
    """
    from hil.app.fmu import show_fmu
    from hil.app.terminal import one_line

    lines, summary = show_fmu(fmu)
    for line in lines:
        click.echo(one_line(line))  # not folded: the section is to be copied
    finish_lines((), summary)
