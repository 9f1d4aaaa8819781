"""`hil identify`: the loop from a run or a log, and `hil identify payload`: masses and friction from logs."""

from pathlib import Path
from typing import Any

import click

from hil.cli.shared import (
    FILE,
    NOT_NEGATIVE,
    OUTPUT,
    POSITIVE,
    FiniteRange,
    finish_lines,
    log_option,
    reporting,
)


@click.command("payload")
@click.argument("logs", metavar="LOG...", nargs=-1, required=True, type=FILE)
@click.option(
    "--reflected",
    type=NOT_NEGATIVE,
    metavar="KG",
    help="Reflected mass of motor and screw in each leg, where it is known; default: it is identified.",
)
@click.option(
    "-o",
    "--out",
    type=OUTPUT,
    metavar="FILE",
    help="Write the block there as YAML; an earlier one is replaced.",
)
@reporting
def payload(
    logs: tuple[Path, ...], reflected: float | None, out: Path | None, json_file: Path | None
) -> None:
    """Find masses, inertia and friction of the robot in logs of ordinary runs.

    Least squares over the leg forces: the ten parameters of the platform with all it carries (mass, first
    moments, inertia about its origin), and of each leg viscous and Coulomb friction and the reflected mass of
    its motor (--reflected: given instead). The legs' own masses are taken from section `platform`. What is
    found is a body: its pseudo-inertia is positive definite.

    Printed are standard errors that count coloured residuals, the condition number, what this motion cannot
    show (it stays as believed), and how well each log is predicted from the others; of a single log, each
    half from the other. In the end a block for the configuration: the payload beyond the believed platform,
    or the platform's own figures, where they are others than those believed, and the friction for
    `controller.model`.

    Any log with motion of all six axes serves. Nothing but gravity may act on the platform: a load that
    pushes looks like mass. Nothing runs and nothing moves. Guide: docs/guides/identify.md.

    \b
    Examples:
      hil identify payload runs/today.mcap
      hil identify payload runs/a.mcap runs/b.mcap -o payload.yaml
      hil identify payload runs/today.mcap --reflected 9.9

    \b
    Exit code:
      0  identified
      1  identified, and the file could not be written in the end
      2  not identified: no log, or too little motion; the message says what
    """
    from rich.text import Text

    from hil.app.files import new_file, write_whole
    from hil.app.output import console, further, show_lines
    from hil.app.terminal import visible
    from hil.lab.identify import payload_block, payload_report
    from hil.lab.identify.payload import identify_payload

    if out is not None:
        new_file(out, force=False, option="-o", own=payload_block.REMARK.encode())
    with console.status("reading") as status:
        found = identify_payload(list(logs), reflected, lambda what: status.update(Text(visible(what))))
    show_lines(payload_report.report(found))
    summary = payload_report.summary(found)
    block = payload_block.block_text(found)
    click.echo(f"\n{block}" if block else "Nothing to paste", nl=not block)
    if out is not None:
        with further(summary):
            write_whole(out, payload_block.file_text(found))
            click.echo(f"\nwritten: {out}")
    finish_lines((), summary, json_file)


class _OrPayload(click.Command):
    """A command whose first word may be `payload`, which is a command of its own."""

    def make_context(
        self, info_name: str | None, args: list[str], parent: click.Context | None = None, **extra: Any
    ) -> click.Context:
        """Return the context of the command that the words ask for."""
        if args and args[0] == payload.name:
            return payload.make_context(f"{info_name} {payload.name}", args[1:], parent, **extra)
        return super().make_context(info_name, args, parent, **extra)


@click.command(cls=_OrPayload)
@click.argument("configuration", metavar="CONFIG|LOG", default="virtual", type=FILE)
@click.option(
    "--delay", is_flag=True, help="Only the delay, from the measurement to the force that answers it."
)
@click.option(
    "--run", "real_time", is_flag=True, help="In real time: moves real drives. Default is lockstep."
)
@click.option("--plant", "with_plant", is_flag=True, help="With --run: start `hil plant` at the other end.")
@click.option("--arm", is_flag=True, help="With --run: move as soon as all drives are ready, without asking.")
@click.option(
    "--force",
    type=POSITIVE,
    metavar="N",
    help="Largest leg force of the excitation; default 2 % of limits.force_N, less where limits ask for it.",
)
@click.option(
    "--duration",
    type=FiniteRange(min=1, max=1e5),
    metavar="S",
    help="Of the excitation, fading in and out included; default 12.5, with --delay 4.",
)
@click.option(
    "-o",
    "--model",
    type=OUTPUT,
    metavar="FILE",
    help="Axis model to write, an earlier one is replaced; default LOG-axes.yaml. Its picture is beside it.",
)
@log_option
@reporting
def command(
    configuration: Path,
    delay: bool,
    real_time: bool,
    with_plant: bool,
    arm: bool,
    force: float | None,
    duration: float | None,
    model: Path | None,
    log: Path | None,
    json_file: Path | None,
) -> None:
    """Measure what the loop is like, from a run that excites it or from a log that is there.

    Masses, inertia and friction are found by `hil identify payload LOG...`, which has a help of its own.

    Without --delay: the linearised axes, from the acceleration that the law demands of each leg (pose laws:
    of x, y, z and the rotations about them) to where it is. Frequency response with coherence and standard
    deviations, the nominal axis gain exp(-transport s) / (lag s + 1) / s^2 behind the hold, and a bound of
    |P/P0 - 1| over frequency, as `hil design` takes them (-o), with a picture. It needs a law that
    linearises: inverse_dynamics, pose_inverse_dynamics, partial_linearisation, sliding_mode,
    robust_inverse_dynamics or state_space.

    --delay: how long it takes from the encoders' latch to the force that answers it, split into transport
    (a pure delay: feedback, computing, command), lag (the drives' force loop, first order) and hold (half a
    period). A law with a model compensates it: section controller.delay_compensation; the wrench observer
    wants transport and lag, too: section estimation.wrench. With any law.

    With CONFIG, the platform is moved by small sinusoids about home (or the pose of a hold reference):
    engage, excite, park, as an ordinary run, with all its limits. Each axis has 12 lines of its own from 1 Hz
    to a tenth of the rate, while all legs extend by some 50 mm, more with more --force, so that friction does
    not change its sign.
    With --delay there are 36 lines from 10 Hz to 0.3 of the rate, while all legs extend and retract slowly by
    3 mm. Ctrl-C stops and parks. In lockstep by default, which needs a section plant; with --run in real
    time, which moves real drives.

    With LOG, nothing runs. Sinusoids and multisines are cut into whole periods, anything else (a chirp) into
    segments of 2 s; what is not coherent with its reference is not used. For --delay any log serves in which
    the forces vary, and one with quick changes tells the split.

    Uncertainties are two standard deviations. Guide: docs/guides/identify.md.

    \b
    Examples:
      hil identify virtual                        the axes of the virtual plant, in lockstep
      hil identify virtual -o axes.yaml           the same, into a file of your own
      hil identify my.yaml --run                  real drives: they move by some 50 mm
      hil identify my.yaml --run --force 800      more force, where friction or noise hides the answer
      hil identify runs/today.mcap                a run that is there already
      hil identify virtual --delay --run --plant --arm    only the delay, in real time
      hil identify payload runs/today.mcap        masses, inertia and friction of the robot

    \b
    Exit code:
      0  measured
      1  the run for it ended in a fault, and its log tells; or a file could not be written in the end
      2  not measured: configuration, log, or too little excitation; the message says what
    """
    from hil.app.output import log_path
    from hil.lab.identify import axes, runs
    from hil.lab.identify import delay as delay_of

    if delay and model:
        raise click.UsageError("--model has no use with --delay, which prints what it finds")
    made = run = files = None
    if runs.is_log(configuration):
        if real_time or with_plant or arm or force or duration or log:
            raise click.UsageError(
                f"{configuration} is a log: --run, --plant, --arm, --force, --duration, --log have no use"
            )
        log = configuration
    else:
        from hil.app.configuration.configuration import load

        loaded = load(configuration)
        excite = delay_of.excited if delay else axes.excited_axes
        made = excite(loaded, force, duration)
        log = log_path(loaded.recording.folder, made.configuration.name, log)
    if not delay:
        files = axes.outputs(log, model)
    if made is not None:
        run = runs.run_for(made, log, real_time=real_time, with_plant=with_plant, arm=arm)
        if not run["success"]:
            click.echo(
                f"hil: the run failed: {run['trouble'] or run['faults']}; its log is {run['log']}", err=True
            )
            finish_lines((), run, json_file)
    if files is None:
        result = delay_of.delay_of_log(log)
        lines = delay_of.report(result)
    else:
        found = axes.axes_of_log(log)
        result = axes.summary(found, log, axes.save(found, files, log.stem))
        lines = axes.report(result, found.model)
    if made is not None:
        result |= {"excitation_N": made.force_N, "run": run}
    finish_lines(lines, result, json_file)
