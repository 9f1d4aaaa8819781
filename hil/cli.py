"""The command line: a table over hil.app. Imports of the heavy parts wait until a command needs them."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import Any, Literal

import click

from drivers.errors import HilError

FILE = click.Path(dir_okay=False, path_type=Path)
_json = click.option(
    "--json", "json_file", type=FILE, metavar="FILE", help="Write the summary there as JSON."
)
_log = click.option("--log", type=FILE, metavar="FILE", help="Log file to write; an existing one is refused.")
_duration = click.option(
    "--duration", type=click.FloatRange(min=0, min_open=True), metavar="S", help="Stop after S seconds."
)
_configuration = click.argument("configuration", default="virtual")


def _finish(title: str, summary: dict[str, Any], json_file: Path | None) -> None:
    """Print a summary, write its JSON twin, and exit 0 only on success."""
    from hil.app.output import show, write_json

    hidden = {"last_ticks"}
    show(title, {k: v for k, v in summary.items() if k not in hidden})
    if json_file is not None:
        write_json(json_file, summary)
    sys.exit(0 if summary["success"] else 1)


def _guarded(command: Callable[..., None]) -> Callable[..., None]:
    """Turn errors that a user can mend into one message and exit code 2."""

    @wraps(command)
    def guarded(*args: Any, **kwargs: Any) -> None:
        try:
            command(*args, **kwargs)
        except HilError as error:
            click.echo(f"hil: {error}", err=True)
            sys.exit(2)

    return guarded


def _announce_compilation() -> None:
    from hil.compile_cache import FIRST_COMPILATION

    if FIRST_COMPILATION:
        click.echo("compiling the mathematics, once (about 20 s) ...", err=True)


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(package_name="hexapod-hil", prog_name="hil")
def main() -> None:
    """Hardware-in-the-loop bridge for six-legged parallel robots on CAN.

    \b
    First steps, nothing but this machine needed:
      hil run --plant        the daemon in real time against emulated drives and the platform's FMU
      hil sim                the same in lockstep, faster than real time
      hil replay LOG         a recorded run again, compared to the bit
      hil check CONFIG       figures and problems of a configuration before anything moves

    CONFIG is a YAML file or the name of a shipped one: virtual, ideal, socketcan, lab, bench, vcan50.
    """


@main.command("run")
@_configuration
@click.option(
    "--plant", "with_plant", is_flag=True, help="Start and supervise `hil plant` at the other end of the bus."
)
@_duration
@_log
@_json
@_guarded
def run_command(
    configuration: str, with_plant: bool, duration: float | None, log: Path | None, json_file: Path | None
) -> None:
    """Run the daemon in real time.

    Waits for six drives, builds up the holding force against the closed brakes, opens them, moves to the
    start of the reference, tracks it, parks and closes the brakes. Ctrl-C stops along the path and parks; a
    second Ctrl-C is an emergency stop. Ends with a summary, a picture and the replay verdict of its log.

    Exit code 0: parked as planned and the log replays exactly. 1: fault or stopped by safety. 2: not begun.
    """
    _announce_compilation()
    from hil.app.configuration import load
    from hil.app.run import run_daemon

    summary = run_daemon(load(configuration), log=log, duration_s=duration, with_plant=with_plant)
    if summary["trouble"]:
        click.echo(f"hil: {summary['trouble']}", err=True)
    _finish("run", summary, json_file)


@main.command("plant")
@_configuration
@_duration
@_log
@_json
@click.option("--supervisor", type=int, hidden=True)
@click.option("--ready", type=int, hidden=True)
@_guarded
def plant_command(
    configuration: str,
    duration: float | None,
    log: Path | None,
    json_file: Path | None,
    supervisor: int | None,
    ready: int | None,
) -> None:
    """Serve six emulated drives and the plant behind them on the bus, in real time.

    The other end for `hil run` without hardware, or for somebody else's controller. Brakes hold at boot and
    after a fault. Logs the true pose. Ends with Ctrl-C or after --duration.
    """
    _announce_compilation()
    from hil.app.configuration import load
    from hil.app.plant import run_plant

    def tell() -> None:
        if ready is not None:
            os.write(ready, b"1")
            os.close(ready)
        else:
            click.echo("drives are on the bus; Ctrl-C ends", err=True)

    summary = run_plant(load(configuration), log=log, duration_s=duration, supervisor=supervisor, ready=tell)
    _finish("plant", summary, json_file)


@main.command("sim")
@_configuration
@_duration
@_log
@_json
@_guarded
def sim_command(configuration: str, duration: float | None, log: Path | None, json_file: Path | None) -> None:
    """Run both ends of the bus in lockstep, in simulated time.

    Deterministic: the same configuration gives the same frames and rows, byte for byte. The bus takes its
    worst-case bit time. `--duration` stops along the path at S simulated seconds.
    """
    _announce_compilation()
    from hil.app.configuration import load
    from hil.app.output import console
    from hil.app.sim import simulate

    with console.status("simulating") as status:
        summary = simulate(
            load(configuration),
            log=log,
            duration_s=duration,
            progress=lambda t, mode: status.update(f"simulating {t:.0f} s  {mode}"),
        )
    _finish("sim", summary, json_file)


@main.command("replay")
@click.argument("log", type=FILE)
@click.option(
    "--salvage",
    type=FILE,
    metavar="OUT",
    help="Recover a log cut by power loss into OUT first, and replay that.",
)
@_json
@_guarded
def replay_command(log: Path, salvage: Path | None, json_file: Path | None) -> None:
    """Run the recorded inputs of LOG through the same code and compare every sent frame and every column.

    Names the first tick and column that differs. Exit code 0: all ticks identical to the bit.
    """
    _announce_compilation()
    from hil.app.replay import replay_log
    from hil.salvage import salvage as recover

    if salvage is not None:
        report = recover(log, salvage)
        click.echo(
            f"salvaged {report.ticks} ticks into {report.out}, {report.bytes_lost} bytes unreadable", err=True
        )
        log = salvage
    verdict, summary = replay_log(log)
    for difference in verdict.first:
        click.echo(f"hil: {difference}", err=True)
    _finish("replay", {"success": verdict.exact, **summary}, json_file)


@main.group("fmu")
def fmu_group() -> None:
    """Build the platform's FMU."""


@fmu_group.command("build")
@click.option("--fmi", type=click.Choice(["2.0", "3.0", "both"]), default="both", show_default=True)
@click.option(
    "--output",
    type=click.Path(file_okay=False, path_type=Path),
    metavar="FOLDER",
    help="Copy the .fmu there.",
)
@_json
@_guarded
def fmu_build_command(fmi: str, output: Path | None, json_file: Path | None) -> None:
    """Compile the platform's physics into FMUs for co-simulation (system `cc`, else ziglang).

    One FMU serves every platform: geometry and inertia are its parameters.
    """
    from plant_fmu.stewart.build import build

    built = {}
    versions: dict[str, tuple[Literal["2.0", "3.0"], ...]] = {
        "2.0": ("2.0",),
        "3.0": ("3.0",),
        "both": ("2.0", "3.0"),
    }
    for version in versions[fmi]:
        out = None if output is None else output / f"stewart-fmi{version[0]}.fmu"
        built[f"fmi_{version[0]}"] = str(build(version, out))
    _finish("fmu build", {"success": True, **built}, json_file)


if __name__ == "__main__":
    main()
