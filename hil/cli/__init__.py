"""The command line: a table of commands, with one row and one file for each."""
# ruff: noqa: E402

import signal

_handler = signal.getsignal(signal.SIGINT)
if _handler is signal.default_int_handler:  # Ctrl-C during these imports ends the process without a word
    signal.signal(signal.SIGINT, signal.SIG_DFL)

import gc
import os
import sys
from importlib import import_module
from typing import Any

import click

from hil import foreign_package

if _found := foreign_package():
    print(f"Error: {_found}", file=sys.stderr)
    sys.exit(2)

from hil.cli.interrupts import attached, one_line_of_interrupt

if _handler is signal.default_int_handler:
    signal.signal(signal.SIGINT, _handler)

# Before anything imports NumPy: no loop uses the threads of its BLAS, which would compete with the loop.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ["MPLBACKEND"] = "agg"  # draws into files, never into windows
# Imported objects live until the end: with the default threshold the collector would scan them some hundred
# times, a tenth of each start.
gc.set_threshold(100_000, 20, 20)


COMMANDS = {
    "run": "The controller, in real time.",
    "plant": "Six emulated drives and the platform, in real time.",
    "sim": "Controller, bus, drives and platform, in simulated time.",
    "replay": "Replay a log's inputs and compare all outputs to the bit.",
    "check": "Figures, warnings and errors of a configuration; nothing moves.",
    "adapter": "Measure a CAN interface before it is trusted: latency, loss, queue, recovery.",
    "doctor": "Findings about this machine's real-time and CAN set-up, with the commands that fix them.",
    "new": "A configuration of your robot from a few figures.",
    "bringup": "Commission a machine, from parts to motion, one leg at a time; also as a rehearsal.",
    "watch": "Live page about a run, in any browser.",
    "export": "A log's frames and columns as files for other tools.",
    "report": "One HTML page about a log: faults and their causes, margins to all limits.",
    "plot": "Columns of logs over time, as PNG or SVG.",
    "view": "A log in Rerun, Foxglove, Lichtblick or PlotJuggler.",
    "faults": "Inject each kind of fault at each moment of a run, and judge the reaction.",
    "campaign": "Run a configuration many times with swept keys; count and locate the failures.",
    "stability": "Stability proof of the control law, with error bounds; nothing moves.",
    "prove": "Prove the stability of your own system by a Lyapunov function.",
    "ctl": "Operator commands to a running controller: hold, start, park, key ...",
    "setpoint": "Send set-points to a running controller with a live reference.",
    "homing": "Show or set parked leg lengths, for motors that lose their turn count at power-off.",
    "workspace": "Map of the reachable poses, with a picture; nothing moves.",
    "compare": "Compare all control laws on your platform and path; nothing moves.",
    "tune": "Gains for your delay, friction and encoders, with margins; nothing moves.",
    "fmu": "Build the platform's FMU; inspect your own.",
    "bus": "CAN FMUs (FMI-LS-BUS) on a simulated or a real CAN bus.",
    "schema": "JSON Schema with which editors complete and check configurations.",
    "calibrate": "Joint positions and length offsets from measured poses.",
    "identify": "Identify axis models or delay, payload and friction, from a run or logs.",
    "learn": "Learn a feed-forward for the next run from the logs of earlier runs.",
    "design": "Design a robust controller from weights: hinf, mu.",
}
"""Name -> one line of help, in the order of the help; the module of that name has the command as `command`.

Other packages register commands by entry points of the group `hil.commands`.
"""

LINUX = {
    "run",
    "plant",
    "doctor",
    "adapter",
    "bringup",
    "watch",
    "bus",
    "ctl",
    "setpoint",
    "homing",
    "identify",
}
"""Commands that need a bus, real time, or another process of this machine."""


def _foreign() -> dict[str, str]:
    """Name -> line of help, with the origin, of each command that another package registers."""
    from drivers.registry import registered

    return {name: f"From {entry.value}." for name, entry in registered("hil.commands").items()}


class _Table(click.Group):
    """COMMANDS and the commands of other packages; a module is imported when its command is called."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        del ctx
        return [*COMMANDS, *_foreign()]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        del ctx
        if cmd_name in COMMANDS:
            if cmd_name in LINUX:
                from drivers.errors import require_linux

                require_linux(f"hil {cmd_name}")
            command = import_module(f"hil.cli.{cmd_name}").command
        elif cmd_name in _foreign():
            from drivers.registry import loaded

            command = loaded("hil.commands", cmd_name)
        else:
            return None
        assert isinstance(command, click.Command)
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Find the command of the arguments; propose the nearest name for an unknown one."""
        try:
            return super().resolve_command(ctx, args)
        except click.UsageError as error:
            from difflib import get_close_matches

            if near := get_close_matches(args[0], self.list_commands(ctx), 1):
                raise click.UsageError(f"{error.message} Did you mean {near[0]!r}?", ctx) from None
            raise

    def invoke(self, ctx: click.Context) -> Any:
        """Call the command; Ctrl-C and errors that a user can fix end it with one line."""
        from hil.cli.shared import one_line_of_error

        with one_line_of_error(), one_line_of_interrupt():
            return super().invoke(ctx)

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        with attached():
            return super().__call__(*args, **kwargs)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        del ctx
        with formatter.section("Commands"):
            formatter.write_dl([*COMMANDS.items(), *_foreign().items()])


@click.group(
    cls=_Table,
    invoke_without_command=True,
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)
@click.option("--version", is_flag=True, help="Show the version; with -v all that a bug report needs.")
@click.option("-v", "--verbose", is_flag=True, help="With --version: machine, packages, FMU, caches.")
@click.pass_context
def main(ctx: click.Context, version: bool, verbose: bool) -> None:
    """Hardware-in-the-loop bridge for six-legged parallel robots on CAN.

    First steps, on this machine alone: new, check, sim, run --plant, watch, replay, report.

    CONFIG is a YAML file or the name of a shipped one: virtual (the default), ideal,
    virtual-cia402, socketcan, lab, lab-cia402, two_buses, desktop, bench, vcan50. Logs
    are MCAP files; without --log they go into the folder recording.folder of the
    configuration, `runs`, under the name and the time. No log is ever overwritten.

    \b
    Exit codes of every command:
      0  success
      1  it ran with a failure: a fault, an exceeded limit, a difference, a result that is rejected or not
         proven, an output that cannot be written; the summary states which
      2  refused before anything moved; the message states the reason and what is allowed
      130  interrupted by Ctrl-C before there was a result; one line states what was saved
      141  the reader of its output has closed the pipe, as `| head -1` does
    """
    if version:
        from hil.app.about import about

        click.echo("\n".join(about(verbose=verbose)))
        ctx.exit()
    if ctx.invoked_subcommand is None:
        raise click.UsageError("Missing command.", ctx)


__all__ = ["main"]
