"""The command `hil fmu`: its options and help text."""

from pathlib import Path

import click

from hil.cli import shared

FOLDER = click.Path(file_okay=False, path_type=Path)


@click.group()
def command() -> None:
    """Build the platform's FMU, for this project and other tools; inspect your own FMU.

    `hil run --plant`, `hil plant` and `hil sim` build it automatically when needed.
    """


@command.command("build", short_help="Compile the platform's physics into FMUs.")
@shared.option("--output", FOLDER, "FOLDER", "Copy the .fmu there.")
@shared.option(
    "--ls-bus",
    shared.FILE,
    "[CONFIG]",
    "CAN FMU (FMI-LS-BUS 1.0): the platform with six drives of protocol legs. Default: virtual.",
    is_flag=False,
    flag_value="virtual",
)
@shared.reporting
def fmu_build_command(output: Path | None, ls_bus: Path | None) -> None:
    """Compile the platform's physics into FMUs for co-simulation (system `cc`, else ziglang).

    One FMU serves every platform: geometry and inertia are its parameters. The FMU is kept in the user's
    cache. With --ls-bus the FMU has a CAN bus in place of forces, for a controller in another tool; its
    parameters start with the values of CONFIG.

    \b
    Examples:
      hil fmu build --output .               ./stewart-fmi2.fmu, ./stewart-fmi3.fmu for another tool
      hil fmu build --ls-bus lab --output .  ./lab-can.fmu, the other end of its bus

    Guide: docs/guides/own-fmu.md, docs/guides/can-fmus.md.
    """
    from hil.app.fmu import build_can_fmu, build_fmus

    if output is not None:
        output.mkdir(parents=True, exist_ok=True)
    summary = build_fmus(output) if ls_bus is None else build_can_fmu(ls_bus, output)
    shared.finish("fmu build", summary)


@command.command("show", short_help="Variables of an FMU, and a proposed mapping.")
@click.argument("fmu", type=shared.FILE)
@shared.reporting
def fmu_show_command(fmu: Path) -> None:
    """List inputs, outputs and parameters of FMU with their units, and propose section `plant.model`.

    Only its description is read. `hil check` on a configuration with this FMU pushes each leg once.

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
    shared.finish_lines((), summary)
