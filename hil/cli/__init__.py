"""The command line: a table over hil.app, one file and one row a command."""
# ruff: noqa: E402

import signal

_handler = signal.getsignal(signal.SIGINT)
if _handler is signal.default_int_handler:  # Ctrl-C during these imports ends the process without a word
    signal.signal(signal.SIGINT, signal.SIG_DFL)

import gc
import os
from importlib import import_module
from typing import Any

import click

from hil.cli.interrupts import attached, one_line_of_interrupt

if _handler is signal.default_int_handler:
    signal.signal(signal.SIGINT, _handler)

# Before anything imports NumPy: the threads of its BLAS, which no loop uses, would spin beside the loop.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ["MPLBACKEND"] = "agg"  # it draws into files, whatever windows other programs open
# What a command imports and reads is there for good: the collector's usual rhythm would look through it some
# hundred times, a tenth of each start and of what works on arrays alone.
gc.set_threshold(100_000, 20, 20)


COMMANDS = {
    "run": "The controller, in real time.",
    "plant": "Six emulated drives and the platform, in real time.",
    "sim": "Both ends in lockstep, in simulated time.",
    "replay": "A log's inputs again, compared to the bit.",
    "check": "Figures and problems of a configuration; nothing moves.",
    "new": "A configuration of your robot from a few figures.",
    "bringup": "From parts to a moving platform, one leg at a time; rehearsals, too.",
    "watch": "Live page about a run, in any browser.",
    "export": "A log's frames and columns as files for other tools.",
    "report": "One HTML page about a log: what went wrong, or what was left.",
    "plot": "Columns of logs over time, as PNG or SVG.",
    "view": "A log in Rerun, Foxglove, Lichtblick or PlotJuggler.",
    "faults": "Each kind of fault at each moment of a run, with verdicts.",
    "campaign": "Many runs with keys swept: how often it fails, and where.",
    "stability": "What can be proven of the law, with bounds; nothing moves.",
    "prove": "Stability of a system of your own, by a Lyapunov function.",
    "ctl": "The operator's commands to a running controller: hold, start, park, key ...",
    "setpoint": "Send a live reference somewhere while it runs.",
    "homing": "Where the legs were parked, for motors that forget their turns.",
    "workspace": "Map of the reachable poses, with a picture; nothing moves.",
    "compare": "All control laws on your platform and path; nothing moves.",
    "fmu": "Build the platform's FMU; look at one of your own.",
    "schema": "What editors complete and check configurations by.",
    "calibrate": "Joint positions and length offsets from measured poses.",
    "identify": "The loop's axes or delay, from a run or a log; payload and friction.",
    "learn": "A feed-forward for the next run, from the logs of those before.",
    "design": "A robust controller from weights: hinf, mu.",
}
"""Name -> what it is for, in the order of the help; the module of that name has it as `command`.

Other packages register theirs by entry points of the group `hil.commands`.
"""


def _foreign() -> dict[str, str]:
    """Commands of other packages, each with where it is from."""
    from drivers.registry import registered

    return {name: f"From {entry.value}." for name, entry in registered("hil.commands").items()}


class _Table(click.Group):
    """COMMANDS and those of other packages; a module is imported when its command is called."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        del ctx
        return [*COMMANDS, *_foreign()]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        del ctx
        if cmd_name in COMMANDS:
            command = import_module(f"hil.cli.{cmd_name}").command
        elif cmd_name in _foreign():
            from drivers.registry import loaded

            command = loaded("hil.commands", cmd_name)
        else:
            return None
        assert isinstance(command, click.Command)
        return command

    def invoke(self, ctx: click.Context) -> Any:
        """Call the command; Ctrl-C, and what a user can fix, end it in one line."""
        from hil.cli.shared import one_line_of_error

        with one_line_of_error(), one_line_of_interrupt():
            return super().invoke(ctx)

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        """Be the work of this process."""
        with attached():
            return super().__call__(*args, **kwargs)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        del ctx
        with formatter.section("Commands"):
            formatter.write_dl([*COMMANDS.items(), *_foreign().items()])


@click.group(cls=_Table, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(package_name="hexapod-hil", prog_name="hil")
def main() -> None:
    """Hardware-in-the-loop bridge for six-legged parallel robots on CAN.

    \b
    First steps, nothing but this machine needed:
      hil new FILE           a configuration of your own robot, from a few figures
      hil check              figures and problems of a configuration, nothing moves
      hil stability          what is proven of the law, with bounds of the error
      hil workspace          map of the reachable poses, with a picture
      hil compare            all control laws on this platform, path, bus and drives
      hil sim                controller, bus, drives and platform in simulated time
      hil run --plant        the same in real time; moves on Enter, or with --arm
      hil watch              a live page about what runs, in any browser
      hil replay LOG         a recorded run again, compared to the bit
      hil report LOG         a page about it: what went wrong, or what was left of limits
      hil faults             what becomes of every kind of fault, at every moment

    CONFIG is a YAML file or the name of a shipped one: virtual (the default), ideal,
    virtual-cia402, socketcan, lab, lab-cia402, two_buses, desktop, bench, vcan50. Logs
    are MCAP files; without --log they go into the folder recording.folder of the
    configuration, `runs`, under the name and the time. No log is ever overwritten.

    \b
    Exit codes of every command:
      0  success
      1  it ran, and something is wrong: a fault, a limit not kept, a difference, a result that is refused
         or not proven, an output that cannot be written; the summary tells
      2  refused before anything moved; the message tells why and what is allowed
      130  interrupted by Ctrl-C before there was a result; one line tells what there is
      141  nobody reads its output any more, as after `| head -1`
    """


__all__ = ["main"]
