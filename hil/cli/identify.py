"""`hil identify`."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from hil.cli.shared import FILE, announce_compilation, guarded, json_option, log_option


@click.command("identify", short_help="What the loop is like: its delay, from a run or a log.")
@click.argument("configuration", metavar="CONFIG|LOG", default="virtual", type=FILE)
@click.option("--delay", is_flag=True, help="From the measurement to the force that answers it.")
@click.option(
    "--run", "real_time", is_flag=True, help="In real time: moves real drives. Default is lockstep."
)
@click.option("--plant", "with_plant", is_flag=True, help="With --run: start `hil plant` at the other end.")
@click.option(
    "--force",
    type=click.FloatRange(min=0, min_open=True),
    metavar="N",
    help="Largest leg force of the excitation; default 2 % of limits.force_N, less where limits ask for it.",
)
@click.option(
    "--duration",
    type=click.FloatRange(min=1),
    metavar="S",
    help="Of the excitation, fading in and out included; default 4.",
)
@log_option
@json_option
@guarded
def identify_command(
    configuration: Path,
    delay: bool,
    real_time: bool,
    with_plant: bool,
    force: float | None,
    duration: float | None,
    log: Path | None,
    json_file: Path | None,
) -> None:
    """Measure what the loop is like, and print it as a configuration wants it.

    --delay: how long it takes from the encoders' latch to the force that answers it, split into transport
    (a pure delay: feedback, computing, command), lag (the drives' force loop, first order) and hold (half a
    period). A law with a model compensates it: section controller.delay_compensation; the wrench observer
    wants transport and lag, too: section estimation.wrench.

    With CONFIG, the platform is held at home (or at the pose of a hold reference) and moved by 36 sinusoids
    from 10 Hz to 0.3 of the rate, on a slow heave of 3 mm: engage, excite, park, as an ordinary run, with
    all its limits. Ctrl-C stops and parks. In lockstep by default, which needs a section plant; with --run in
    real time, which moves real drives. With LOG, nothing runs: any log of `hil run` or `hil sim` in which
    the forces vary tells the total, and one with quick changes the split.

    The forces that the motion took, from the rigid-body model, are compared with the commands of each leg.
    Gain, offset and friction of each leg are fitted along, so a model that is somewhat wrong does not
    hurt. Uncertainties are two standard deviations.

    \b
    Examples:
      hil identify virtual --delay                the virtual bench, in lockstep
      hil identify virtual --delay --run --plant  the same in real time
      hil identify my.yaml --delay --run          real drives: they move a little
      hil identify runs/today.mcap --delay        a run that is there already

    \b
    Exit code:
      0  measured
      1  the run for it ended in a fault; its log tells
      2  not measured: configuration, log, or too little excitation; the message says what
    """
    if not delay:
        raise click.UsageError("say what to measure: --delay")
    announce_compilation()
    from hil.app import identify
    from hil.app.output import show_lines, write_json

    if identify.is_log(configuration):
        if real_time or with_plant or force or duration or log:
            raise click.UsageError(
                f"{configuration} is a log: --run, --plant, --force, --duration, --log have no use"
            )
        result = identify.delay_of_log(configuration)
    else:
        from hil.app.configuration import load

        made = identify.excited(load(configuration), force, duration)
        run = identify.run_for(made, log, real_time=real_time, with_plant=with_plant)
        if not run["success"]:
            click.echo(
                f"hil: the run failed: {run['trouble'] or run['faults']}; its log is {run['log']}", err=True
            )
            if json_file is not None:
                write_json(json_file, run)
            sys.exit(1)
        result = identify.delay_of_log(Path(run["log"])) | {"excitation_N": made.force_N, "run": run}
    show_lines(identify.report(result))
    if json_file is not None:
        write_json(json_file, result)
