"""`hil design`: a table of methods, one command each."""

from pathlib import Path

import click

from hil.cli.shared import FILE, OUTPUT, finish_lines, reporting

METHODS = {
    "hinf": (
        "H-infinity: the weights are met at every frequency.",
        """Design an H-infinity controller for the linearised axes of a robot, from DESIGN.

    DESIGN is a YAML file or the name of a shipped one: hinf, constant_hinf. It says what the axis is (its
    delay and lag, or a file of `hil identify`), what acts on it (disturbance, noise of the measurements), and
    what is asked: the error allowed at rest and at the worst frequency, the acceleration the controller may
    ask for. gamma says how much of that is used: below 1 all of it is met, for every disturbance and noise
    within their bounds.

    Of all controllers within 1.1 of the best gamma the first is taken that a loop can run: no pole above half
    the Nyquist frequency, no closed-loop pole slower than a tenth of the crossover, the norm of the exact
    sampled loop, delay and hold included, within 1.01 gamma. If there is none, the reason is printed, and
    what to change.""",
    ),
    "mu": (
        "mu: the weights are met whatever the robot is within its uncertainty.",
        """Design a controller by D-K iteration for axes that are known within limits only, from DESIGN.

    DESIGN is a YAML file or the name of a shipped one: mu. Beside what `hil design hinf` takes it says in
    section uncertainty by how much inertia, delay and the drives' bandwidth may differ. mu says how much of
    the weights the worst of these axes uses: below 1 all of it is met by every one of them.

    Each round finds the scales that bound mu best for the controller of the round before, and the H-infinity
    controller for these scales; it ends when mu stops falling. A controller that does not get below 1, or
    that a loop cannot run, is refused with the reason. States that do next to nothing are left out, below
    1e-4 of the largest Hankel singular value, and all bounds printed are of what is left: at the frequencies
    looked at, at every frequency, and of the exact sampled loop at the corners of the uncertainty.""",
    ),
}
"""Name -> one line, and introduction; what it does is in the table of hil.app.design.command."""

EXIT = """

    \b
    Examples:
      hil design {name} {name} -o controller.yaml
      hil design {name} my.yaml --model axis.yaml -o controller.yaml --plot design.png
      hil design {name} my.yaml --model axis.yaml --robot robot.yaml -o controller.yaml
      hil design {name} my.yaml --json design.json

    A file of `hil identify` brings the bound of its error: the controller has to stand it at every frequency,
    and |W T| says how near it comes. With --robot the gain is that of the robot, and the six axes, coupled
    by what its payload does to the inertia, have to stand it together.

    Then `law: state_space` with `controller_file: controller.yaml` in section controller.

    \b
    Exit code:
      0  designed
      1  designed, and a file could not be written in the end
      2  not designed: file, weights, or no controller that can be used; the message says why
    """


@click.group()
def command() -> None:
    """Design a robust controller for the linearised axes, as a file for the law `state_space`."""


def _command(name: str, short: str, text: str) -> click.Command:
    @click.command(name, short_help=short, help=text + EXIT.format(name=name))
    @click.argument("design", metavar="DESIGN")
    @click.option(
        "--model", type=FILE, metavar="AXIS.yaml", help="The axis, from `hil identify`; before DESIGN's own."
    )
    @click.option(
        "--robot",
        metavar="CONFIG",
        help="Stand the coupling of its axes, along its reference, at every corner of its payload's ranges.",
    )
    @click.option(
        "-o",
        "--out",
        type=OUTPUT,
        metavar="FILE",
        help="Write the controller there; an earlier one is replaced.",
    )
    @click.option(
        "--plot", type=OUTPUT, metavar="FILE", help="PNG file: S, T, K S against their weights, and the loop."
    )
    @reporting
    def command(
        design: str,
        model: Path | None,
        robot: str | None,
        out: Path | None,
        plot: Path | None,
        json_file: Path | None,
    ) -> None:
        from hil.app.configuration.section_file import check_section_path
        from hil.app.design import command as app
        from hil.app.files import write_whole
        from hil.app.output import console, further, picture_path, show_lines
        from hil.config.linear_controller import LinearController

        if out is not None:
            check_section_path("-o", out, LinearController)
        picture = None if plot is None else picture_path(".", Path(design).stem, plot, "--plot")
        with console.status("reading") as status:
            controller, made, settings, axis = app.run_design(name, design, model, status.update, robot)
        show_lines(app.report(controller))
        summary = app.summary(controller, design)
        if out is not None:
            with further(summary):
                write_whole(out, app.controller_text(controller, design))
                click.echo(f"written: {out}")
        if picture is not None:
            from hil.app.design.plot import draw

            with further(summary):
                click.echo(f"drawn: {draw(settings, axis, made, picture, f'{design}: {name}')}")
        finish_lines((), summary, json_file)

    return command


for _name, _texts in METHODS.items():
    command.add_command(_command(_name, *_texts))
