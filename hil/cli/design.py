"""`hil design`: a table of methods, one command each."""

from pathlib import Path

import click

from hil.cli import shared

METHODS = {
    "hinf": (
        "H-infinity: the weights are met at every frequency.",
        """Design an H-infinity controller for the linearised axes of a robot, from DESIGN.

    DESIGN is a YAML file or the name of a shipped one: hinf, constant_hinf. It states the axis, its
    disturbances, and the requirements: the error allowed at rest and at the worst frequency, the acceleration
    that the controller may command. gamma is the used share of these bounds: below 1 all of them are met.""",
    ),
    "mu": (
        "mu: the weights are met for every robot within the uncertainty.",
        """Design a controller by D-K iteration for axes with bounded uncertainty, from DESIGN.

    DESIGN is a YAML file or the name of a shipped one: mu. In addition to the keys of `hil design hinf`, its
    section uncertainty states how much inertia, delay and the drives' bandwidth may differ. mu is the share
    of the weights that the worst of these axes uses: below 1 every one of them meets all weights.""",
    ),
}
"""Design method -> one line of help, and the first part of its long help."""
EXAMPLES = """

    \b
    Examples:
      hil design {name} {name} -o controller.yaml
      hil design {name} my.yaml --model axis.yaml --robot robot.yaml --plot design.png

    Guide: docs/guides/design.md.
    """
MODEL = "Axis model from `hil identify`; it replaces DESIGN's own."
ROBOT = "Allow for the coupling of its axes, along its reference, at every corner of its payload ranges."
PLOT = "PNG file: S, T, K S against their weights, and the loop."


@click.group()
def command() -> None:
    """Design a robust controller for the linearised axes, as a file for the law `state_space`."""


def _command(name: str, short: str, text: str) -> click.Command:
    @click.command(name, short_help=short, help=text + EXAMPLES.format(name=name))
    @click.argument("design", metavar="DESIGN")
    @shared.option("--model", shared.FILE, "AXIS.yaml", MODEL)
    @shared.option("--robot", str, "CONFIG", ROBOT)
    @shared.option("-o --out", shared.OUTPUT, "FILE", "Controller to write; an earlier one is replaced.")
    @shared.option("--plot", shared.OUTPUT, "FILE", PLOT)
    @shared.reporting
    def command(
        design: str, model: Path | None, robot: str | None, out: Path | None, plot: Path | None
    ) -> None:
        from hil.app.configuration.section_file import check_section_path
        from hil.app.design import command as app
        from hil.app.output import further, picture_path, show_lines
        from hil.config.linear_controller import LinearController

        if out is not None:
            check_section_path("-o", out, LinearController)
        picture = None if plot is None else picture_path(".", Path(design).stem, plot, "--plot")
        with shared.status("reading") as progress:
            controller, made, settings, axis = app.run_design(name, design, model, progress, robot)
        show_lines(app.report(controller))
        summary = app.summary(controller, design)
        shared.write(summary, out, app.controller_text(controller, design))
        if picture is not None:
            from hil.app.design.plot import draw

            with further(summary):
                click.echo(f"drawn: {draw(settings, axis, made, picture, f'{design}: {name}')}")
        shared.finish_lines((), summary)

    return command


for _name, _texts in METHODS.items():
    command.add_command(_command(_name, *_texts))
