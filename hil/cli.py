"""The command line: a table over hil.app. Imports of the heavy parts wait until a command needs them."""

from __future__ import annotations

import contextlib
import json
import os
import sys
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import click

if TYPE_CHECKING:
    from hil.app.configuration import Configuration

FILE = click.Path(dir_okay=False, path_type=Path)
_json = click.option(
    "--json", "json_file", type=FILE, metavar="FILE", help="Write the summary there as JSON, too."
)
_log = click.option("--log", type=FILE, metavar="FILE", help="Log file to write; an existing one is refused.")
_duration = click.option(
    "--duration", type=click.FloatRange(min=0, min_open=True), metavar="S", help="Stop after S seconds."
)
_configuration = click.argument("configuration", default="virtual")


def _finish(
    title: str, summary: dict[str, Any], json_file: Path | None, shown: dict[str, Any] | None = None
) -> None:
    """Print a summary (`shown`, where that says it better), write its JSON twin, exit 0 only on success."""
    from hil.app.output import show, write_json

    show(title, summary if shown is None else shown)
    if json_file is not None:
        write_json(json_file, summary)
    sys.exit(0 if summary["success"] else 1)


def _guarded(command: Callable[..., None]) -> Callable[..., None]:
    """Turn errors that a user can mend into one message and exit code 2; check the output files first."""

    @wraps(command)
    def guarded(*args: Any, **kwargs: Any) -> None:
        from drivers.errors import HilError

        try:
            if kwargs["json_file"] is not None:
                from hil.app.output import check_json_path

                check_json_path(kwargs["json_file"], *_other_files(kwargs))
            command(*args, **kwargs)
        except HilError as error:
            _refuse(str(error))
        except OSError as error:
            place = "" if error.filename is None else f"{error.filename}: "
            _refuse(f"{place}{error.strerror or error}")

    return guarded


def _other_files(arguments: dict[str, Any]) -> list[Path]:
    given = (arguments.get(name) for name in ("configuration", "log", "salvage", "picture"))
    return [Path(file) for file in given if file is not None]


def _refuse(message: str) -> None:
    click.echo(f"hil: {message}", err=True)
    sys.exit(2)


def _announce_compilation() -> None:
    from hil.compile_cache import FIRST_COMPILATION

    if FIRST_COMPILATION:
        click.echo("compiling the mathematics, once (about 20 s) ...", err=True)


def _load(configuration: str, command: Literal["run", "plant", "sim"]) -> Configuration:
    """Load a configuration and refuse what cannot work, before anything starts.

    Raises ConfigurationError.
    """
    from hil.app.configuration import load

    loaded = load(configuration)
    loaded.require(command)
    _announce_compilation()
    from hil.app.check import refuse_unreachable

    refuse_unreachable(loaded)
    return loaded


class _InOrder(click.Group):
    """Lists its commands in the order in which they were added."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        del ctx
        return list(self.commands)


@click.group(cls=_InOrder, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(package_name="hexapod-hil", prog_name="hil")
def main() -> None:
    """Hardware-in-the-loop bridge for six-legged parallel robots on CAN.

    \b
    First steps, nothing but this machine needed:
      hil check              figures and problems of a configuration, nothing moves
      hil workspace          map of the reachable poses, with a picture
      hil sim                controller, bus, drives and platform in simulated time
      hil run --plant        the same in real time, the platform's FMU behind the bus
      hil replay LOG         a recorded run again, compared to the bit

    CONFIG is a YAML file or the name of a shipped one: virtual (the default), ideal,
    socketcan, lab, bench, vcan50. Logs are MCAP files; without --log they go into the
    folder recording.folder of the configuration, `runs`, under the name and the time.
    No log is ever overwritten.

    \b
    Exit codes of every command:
      0  success
      1  it ran, and something was wrong; the summary says what
      2  refused before anything moved; the message says why and what is allowed
    """


@main.command("run", short_help="The controller, in real time.")
@_configuration
@click.option(
    "--plant", "with_plant", is_flag=True, help="Start and supervise `hil plant` at the other end of the bus."
)
@click.option("--reset", is_flag=True, help="Clear faults that the drives have latched before engaging.")
@_duration
@_log
@_json
@_guarded
def run_command(
    configuration: str,
    with_plant: bool,
    reset: bool,
    duration: float | None,
    log: Path | None,
    json_file: Path | None,
) -> None:
    """Run the daemon in real time.

    Waits for six drives, builds up the holding force against the closed brakes, opens them, moves to the
    start of the reference, tracks it, parks and closes the brakes. Ctrl-C stops along the path and parks; a
    second Ctrl-C is an emergency stop. Ends with a summary, a picture and the replay verdict of its log.

    \b
    Examples:
      hil run --plant                       all virtual; needs nothing but this machine
      hil run --plant --duration 5          the same, parked after 5 s
      hil run socketcan                     real drives on can0
      hil run socketcan --reset             the same, clearing faults that the drives have latched
      hil run my.yaml --log today.mcap --json today.json

    The log goes to --log, else to runs/NAME-TIME.mcap (recording.folder). With --plant the plant's own log,
    with the true pose, stands beside it as ...-plant.mcap; the picture is the log's name with .png.

    \b
    Exit code:
      0  parked as planned or on request, and what was recorded replays exactly
      1  a latched fault, no drives, or stopped by safety; the log is closed and tells
      2  not begun: configuration, bus, plant or log file; the message says what
    """
    loaded = _load(configuration, "run")
    from hil.app.run import run_daemon

    summary = run_daemon(loaded, log=log, duration_s=duration, with_plant=with_plant, reset=reset)
    if "last_ticks" in summary:
        from hil.app.output import last_ticks_table

        click.echo(last_ticks_table(summary["last_ticks"]), err=True)
    if summary["trouble"]:
        click.echo(f"hil: {summary['trouble']}", err=True)
    _finish("run", summary, json_file)


@main.command("plant", short_help="Six emulated drives and the platform, in real time.")
@_configuration
@_duration
@_log
@_json
@click.option("--supervisor", type=int, hidden=True)
@click.option("--report", type=int, hidden=True)
@_guarded
def plant_command(
    configuration: str,
    duration: float | None,
    log: Path | None,
    json_file: Path | None,
    supervisor: int | None,
    report: int | None,
) -> None:
    """Serve six emulated drives and the plant behind them on the bus, in real time.

    The other end for `hil run` without hardware, or for somebody else's controller. Brakes hold at boot and
    after a fault. Logs the true pose. Ends with Ctrl-C or after --duration.

    \b
    Examples:
      hil plant                             then, in another terminal: hil run
      hil plant lab --duration 60
      hil plant vcan50                      on a SocketCAN bus, for any controller

    The log goes to --log, else to runs/NAME-TIME-plant.mcap (recording.folder); `plant.log: false` in the
    configuration writes none.

    \b
    Exit code:
      0  ended as asked
      1  the plant failed on the way
      2  not begun: configuration, bus, FMU or log file; the message says what
    """
    loaded = _load(configuration, "plant")
    from hil.app.plant import run_plant

    def tell() -> None:
        if report is not None:
            os.write(report, b"\n")
        else:
            click.echo("drives are on the bus; Ctrl-C ends", err=True)

    summary = run_plant(loaded, log=log, duration_s=duration, supervisor=supervisor, ready=tell)
    if report is not None:
        with contextlib.suppress(OSError):  # nobody listens when the daemon was killed
            os.write(report, json.dumps(summary).encode())
    if summary["trouble"]:
        click.echo(f"hil: {summary['trouble']}", err=True)
    _finish("plant", summary, json_file)


@main.command("sim", short_help="Both ends in lockstep, in simulated time.")
@_configuration
@_duration
@_log
@_json
@_guarded
def sim_command(configuration: str, duration: float | None, log: Path | None, json_file: Path | None) -> None:
    """Run both ends of the bus in lockstep, in simulated time, as fast as the machine can.

    Deterministic: the same configuration gives the same frames and rows, byte for byte. The bus takes its
    worst-case bit time. `--duration` stops along the path at S simulated seconds and parks.

    \b
    Examples:
      hil sim                               the default bench, ten periods of the path
      hil sim ideal                         theory: exact lengths and rates, no bus time
      hil sim lab --duration 3 --log lab.mcap --json lab.json

    The log goes to --log, else to runs/NAME-TIME.mcap (recording.folder), and is replayed at the end.

    \b
    Exit code:
      0  parked without a fault, and the log replays exactly
      1  a latched fault, or the replay differs
      2  not begun: configuration, FMU or log file; the message says what
    """
    loaded = _load(configuration, "sim")
    from hil.app.sim import simulate

    summary = simulate(loaded, log=log, duration_s=duration, live=sys.stderr.isatty())
    if summary["trouble"]:
        click.echo(f"hil: {summary['trouble']}", err=True)
    _finish("sim", summary, json_file)


@main.command("replay", short_help="A log's inputs again, compared to the bit.")
@click.argument("log", type=FILE)
@click.option(
    "--salvage",
    type=FILE,
    metavar="OUT",
    help="Recover a log cut by power loss into the new file OUT first, and replay that.",
)
@_json
@_guarded
def replay_command(log: Path, salvage: Path | None, json_file: Path | None) -> None:
    """Run the recorded inputs of LOG through the same code and compare every sent frame and every column.

    LOG comes from `hil run` or `hil sim`; its configuration is inside. Only reads: nothing is sent, LOG
    stays as it is. Names the first tick and each column that differs there, with both values.

    \b
    Examples:
      hil replay runs/virtual-20260131T120000.mcap
      hil replay cut.mcap --salvage whole.mcap

    \b
    Exit code:
      0  all ticks identical to the bit (on another CPU: all frames, columns to 1e-9)
      1  differences, or ticks missing from the log
      2  not begun: no such file, no log, cut (then use --salvage)
    """
    from hil.log import Log

    if salvage is None:
        Log.open(log)
    _announce_compilation()
    from hil.app.replay import replay_log
    from hil.salvage import salvage as recover

    if salvage is not None:
        report = recover(log, salvage)
        click.echo(
            f"salvaged {report.ticks} ticks into {report.out}, {report.bytes_lost} bytes unreadable", err=True
        )
        log = salvage

    def tell(ticks: int) -> None:
        click.echo(f"\r{ticks} ticks", err=True, nl=False)

    shown = sys.stderr.isatty()
    verdict, summary = replay_log(log, tell if shown else None)
    if shown:
        click.echo("\r\x1b[K", err=True, nl=False)
    for difference in verdict.first:
        click.echo(f"hil: {difference}", err=True)
    result = {"success": summary["agrees"], "kind": "replay", "log": str(log), **summary}
    short = {key: result[key] for key in ("success", "log", "wall_s", "times_real_time")}
    if "remark" in summary:
        short["remark"] = summary["remark"]
    if not verdict.exact:
        short["largest_relative_difference"] = verdict.largest
    _finish("replay", result, json_file, {**short, "replay": summary})


@main.command("check", short_help="Figures and problems of a configuration; nothing moves.")
@_configuration
@_json
@_guarded
def check_command(configuration: str, json_file: Path | None) -> None:
    """Say what the bus, the legs and the limits have to say about CONFIGURATION, before anything moves.

    Bus time of a tick with its arithmetic, forces and lengths at home and along the whole reference, drive
    watchdog, delay against the law's bandwidth, real-time rights of this machine. Opens no bus,
    writes no log.

    \b
    Examples:
      hil check                             the default configuration
      hil check my.yaml --json my-check.json

    \b
    Exit code:
      0  usable; read the warnings
      2  not usable: all problems at once, each as FILE:LINE:COLUMN: path: what, allowed, given
    """
    from drivers.errors import ConfigurationError
    from hil.app.configuration import load
    from hil.app.output import show_lines, write_json

    try:
        loaded = load(configuration)
        _announce_compilation()
        from hil.app.check import inspect

        report = inspect(loaded)
    except ConfigurationError as error:
        if json_file is not None:
            problems = list(error.problems)
            write_json(json_file, {"success": False, "kind": "check", "problems": problems})
        raise
    show_lines(report.lines)
    if json_file is not None:
        write_json(json_file, {"success": True, "kind": "check", **report.to_dict()})


@main.command("workspace", short_help="Map of the reachable poses, with a picture; nothing moves.")
@_configuration
@click.option(
    "--resolution",
    type=click.IntRange(8, 160),
    default=60,
    show_default=True,
    metavar="N",
    help="Steps of the grid along the longest side of the workspace.",
)
@click.option(
    "--position",
    type=(float, float, float),
    metavar="X Y Z",
    help="Where to map orientations, m in the base frame; default: home.",
)
@click.option(
    "--payload",
    type=click.FloatRange(min=0),
    default=0.0,
    metavar="KG",
    help="Further mass on the platform, for the static leg forces.",
)
@click.option(
    "--payload-at",
    type=(float, float, float),
    default=(0.0, 0.0, 0.0),
    metavar="X Y Z",
    help="Its centre of mass, m in the platform frame; default: the origin.",
)
@click.option(
    "--leg-diameter",
    type=click.FloatRange(min=0, min_open=True),
    metavar="M",
    help="Look at collisions of legs this thick, too.",
)
@click.option(
    "--picture", type=FILE, metavar="FILE", help="PNG file to draw; an earlier picture is replaced."
)
@_json
@_guarded
def workspace_command(
    configuration: str,
    resolution: int,
    position: tuple[float, float, float] | None,
    payload: float,
    payload_at: tuple[float, float, float],
    leg_diameter: float | None,
    picture: Path | None,
    json_file: Path | None,
) -> None:
    """Map the poses that the platform can reach from home within stroke, joint angle and force limits.

    Translations at home's orientation: volume, extents, sections with the limit that is met along the edge,
    the largest sphere and cylinder. Tilt and torsion at one position. Condition number and singularity
    measure, static leg forces. What lies behind a singularity or a gap is not reachable and does not count.
    Joint angles: platform.base_joint_angle_max_deg and platform.platform_joint_angle_max_deg.

    \b
    Examples:
      hil workspace                         the default bench
      hil workspace lab --picture lab.png --json lab.json
      hil workspace lab --payload 200 --position 0 0 0.9
      hil workspace my.yaml --resolution 120 --leg-diameter 0.08

    The picture goes to --picture, else to runs/NAME-workspace-TIME.png (recording.folder).

    \b
    Exit code:
      0  mapped
      2  not begun: configuration, home outside a limit, position not reached, file
    """
    from hil.app.configuration import load
    from hil.app.output import console

    loaded = load(configuration)
    _announce_compilation()
    with console.status("loading the mathematics") as status:
        from hil.app.workspace import map_workspace, shown

        summary = map_workspace(
            loaded,
            resolution=resolution,
            position=position,
            payload_kg=payload,
            payload_at=payload_at,
            leg_diameter_m=leg_diameter,
            picture=picture,
            progress=lambda what: status.update(f"mapping: {what}"),
        )
    _finish("workspace", summary, json_file, shown(summary))


@main.group("fmu", short_help="Build the platform's FMU.")
def fmu_group() -> None:
    """Build the platform's FMU, for this project and for any other tool that takes FMUs.

    `hil run --plant`, `hil plant` and `hil sim` build it by themselves when it is needed.
    """


@fmu_group.command("build", short_help="Compile the platform's physics into FMUs.")
@click.option(
    "--fmi",
    type=click.Choice(["2.0", "3.0", "both"]),
    default="both",
    show_default=True,
    help="FMI version of the interface; the physics is the same.",
)
@click.option(
    "--output",
    type=click.Path(file_okay=False, path_type=Path),
    metavar="FOLDER",
    help="Copy the .fmu there.",
)
@_json
@_guarded
def fmu_build_command(
    fmi: Literal["2.0", "3.0", "both"], output: Path | None, json_file: Path | None
) -> None:
    """Compile the platform's physics into FMUs for co-simulation (system `cc`, else ziglang).

    One FMU serves every platform: geometry and inertia are its parameters. The result stays in the user's
    cache and is built again only when its sources change. No log.

    \b
    Examples:
      hil fmu build                         both versions, into the cache
      hil fmu build --fmi 3.0 --output .    ./stewart-fmi3.fmu for another tool

    \b
    Exit code:
      0  built; the summary names the files
      2  no compiler, it failed, or FOLDER cannot be written
    """
    from hil.app.fmu import build_fmus

    if output is not None:
        output.mkdir(parents=True, exist_ok=True)
    _finish("fmu build", build_fmus(fmi, output), json_file)


@main.command("calibrate", short_help="Joint positions and length offsets from measured poses.")
@click.argument("configuration")
@click.argument("poses", type=FILE)
@click.option(
    "--out", type=FILE, metavar="FILE", help="Write the joints there as YAML; an existing file is refused."
)
@_json
@_guarded
def calibrate_command(configuration: str, poses: Path, out: Path | None, json_file: Path | None) -> None:
    """Fit joint positions and length offsets of CONFIGURATION to the measured pairs in POSES, a CSV file.

    Columns x_m,y_m,z_m,rx_deg,ry_deg,rz_deg (pose of the platform, rotation vector) and l1_m to l6_m (what
    the legs read, in the order of the joint lists); optional standard deviations length_std_m,
    position_std_m, rotation_std_deg. At least 8 rows; some 30, all over the workspace and tilted, are good.
    Says how sure each figure is, and which these poses cannot determine. CONFIGURATION is not changed.

    \b
    Examples:
      hil calibrate my.yaml poses.csv                      the report
      hil calibrate my.yaml poses.csv --out joints.yaml    and the joints, to copy into my.yaml

    \b
    Exit code:
      0  fitted; read the warnings
      2  not fitted: configuration, CSV file, units, too few poses; the message says what
    """
    from hil.app.calibrate import run_calibration
    from hil.app.output import show_lines, write_json

    report = run_calibration(configuration, poses, out, json_file)
    show_lines(report.lines)
    if out is None:
        click.echo(report.fragment, nl=False)
    if json_file is not None:
        write_json(json_file, {"success": True, "kind": "calibrate", **report.figures})


if __name__ == "__main__":
    main()
