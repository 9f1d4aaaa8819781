"""`hil identify`: axis models or delay; `payload`: masses and friction; `sensors`: their calibration."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from hil.cli import shared

REFLECTED = "Reflected mass of motor and screw of each leg, if known; else it is identified."
FORCE = "Largest leg force of the excitation; default 2 % of limits.force_N, less if limits require it."
DURATION = "Duration of the excitation, including fade-in and fade-out; default 12.5, with --delay 4."
MODEL = "Axis model to write, an earlier one is replaced; default LOG-axes.yaml. Its picture goes next to it."


@click.command("payload")
@click.argument("logs", metavar="LOG...", nargs=-1, required=True, type=shared.FILE)
@shared.option("--reflected", shared.NOT_NEGATIVE, "KG", REFLECTED)
@shared.option("-o --out", shared.OUTPUT, "FILE", "YAML of the block; an earlier one is replaced.")
@shared.reporting
def payload(logs: tuple[Path, ...], reflected: float | None, out: Path | None) -> None:
    """Find masses, inertia and friction of the robot in logs of ordinary runs.

    Least squares over the leg forces, from any log with motion of all six axes and no load on the platform
    but gravity. Prints standard errors, parameters that this motion does not determine, and a block for the
    configuration: payload, platform and `controller.model`. Nothing moves.

    \b
    Examples:
      hil identify payload runs/a.mcap runs/b.mcap -o payload.yaml

    Guide: docs/guides/identify.md.
    """
    from hil.lab.identify import payload_report
    from hil.lab.identify.payload import identify_payload

    _block(payload_report, lambda: identify_payload(list(logs), reflected), out)


@click.command("sensors")
@click.argument("log", metavar="LOG", type=shared.FILE)
@shared.option("-o --out", shared.OUTPUT, "FILE", "YAML of the block; an earlier one is replaced.")
@shared.reporting
def sensors(log: Path, out: Path | None) -> None:
    """Calibrate the sensors of a log: frame, lever arm, time offset, offset and scale.

    Least squares against the pose by the leg lengths, from any log of some seconds with motion of all six
    axes. Prints two standard errors, leaves out what this motion does not determine, and prints a block for
    section `sensors`. Nothing moves.

    \b
    Examples:
      hil identify sensors runs/a.mcap -o calibration.yaml

    Guide: docs/guides/sensors.md.
    """
    from hil.lab.identify import sensors as of_sensors

    _block(of_sensors, lambda: of_sensors.identify_sensors(log), out)


def _block(shown: Any, identify: Callable[[], Any], out: Path | None) -> None:
    """Identify from logs; show the report and the keys to paste, as module `shown` makes them."""
    from hil.app.files import beginning, new_file
    from hil.app.output import show_lines

    if out is not None:
        new_file(out, option="-o", own=beginning("a file of hil identify", shown.REMARK.encode()))
    with shared.status("reading the logs, and fitting"):
        found = identify()
    show_lines(shown.report(found))
    summary = shown.summary(found)
    block = shown.block_text(found)
    click.echo(f"\n{block}" if block else "Nothing to paste")
    shared.write(summary, out, shown.file_text(found))
    shared.finish_lines((), summary)


class _OrOther(shared.OrOther):
    others = (payload, sensors)


@click.command(cls=_OrOther)
@click.argument("configuration", metavar="CONFIG|LOG", default="virtual", type=shared.FILE)
@shared.flag("--delay", "Identify only the delay, from the measurement to the force that responds to it.")
@shared.flag("--run real_time", "In real time: moves real drives. Default is lockstep.")
@shared.flag("--plant with_plant", "With --run: start `hil plant` at the other end.")
@shared.flag("--arm", "With --run: move as soon as all drives are ready, without confirmation.")
@shared.option("--force", shared.POSITIVE, "N", FORCE)
@shared.option("--duration", shared.FiniteRange(min=1, max=1e5), "S", DURATION)
@shared.option("-o --model", shared.OUTPUT, "FILE", MODEL)
@shared.log_option
@shared.reporting
def command(
    configuration: Path,
    delay: bool,
    model: Path | None,
    log: Path | None,
    force: float | None,
    duration: float | None,
    **how: bool,
) -> None:
    """Identify the control loop, from a run that excites it or from an existing log.

    Results are the linearised axes, with a nominal model and its error bound, as input of `hil design`; with
    --delay only the time from the encoders' sampling to the force that responds to it. With CONFIG, small
    sinusoids move the platform about home, in lockstep, or with --run in real time, which moves real drives
    by some 50 mm; Ctrl-C stops and parks. Masses, inertia and friction: `hil identify payload LOG...`;
    sensors: `hil identify sensors LOG`.

    \b
    Examples:
      hil identify my.yaml --run --force 800      real drives; more force, if friction hides the response
      hil identify runs/today.mcap                an existing log
      hil identify virtual --delay --run --plant --arm    only the delay, in real time

    Guide: docs/guides/identify.md.
    """
    from hil.app.output import log_path
    from hil.lab.identify import axes, runs
    from hil.lab.identify import delay as delay_of

    if delay and model:
        raise click.UsageError("--model does not apply to --delay, which only prints the delay")
    made = run = files = None
    if runs.is_log(configuration):
        if any(how.values()) or force or duration or log:
            raise click.UsageError(
                f"{configuration} is a log: --run, --plant, --arm, --force, --duration, --log do not apply"
            )
        log = configuration
    else:
        loaded = shared.load(str(configuration))
        excite = delay_of.excited if delay else axes.excited_axes
        made, force = excite(loaded, force, duration)
        log = log_path(loaded.recording.folder, made.name, log)
    if not delay:
        files = axes.outputs(log, model)
    if made is not None:
        run = runs.run_for(made, log, **how)
        if not run["success"]:
            why = run["trouble"] or run["faults"]
            click.echo(f"hil: the run failed: {why}; its log is {run['log']}", err=True)
            shared.finish_lines((), run)
    if files is None:
        result = delay_of.delay_of_log(log)
        lines = delay_of.report(result)
    else:
        found = axes.axes_of_log(log)
        result = axes.summary(found, log, axes.save(found, files, log.stem))
        lines = axes.report(result, found.model)
    if made is not None:
        result |= {"excitation_N": force, "run": run}
    shared.finish_lines(lines, result)
