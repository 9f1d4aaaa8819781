"""Ctrl-C in a command: what was begun is closed, one line reports it, exit code 130."""

import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

import click

INTERRUPTED = 128 + signal.SIGINT
"""Exit code: what a shell shows of a tool that SIGINT has ended."""


class Interrupts:
    """Handler of SIGINT. Mutable state: whether Ctrl-C was pressed; libraries turn that into other errors."""

    def __init__(self) -> None:
        self.came = False

    def pressed(self, signum: int, frame: FrameType | None) -> None:
        """Raise KeyboardInterrupt, unless one is on its way: files are being closed and processes ended."""
        del signum, frame
        self.came = True
        if not isinstance(sys.exc_info()[1], KeyboardInterrupt):
            raise KeyboardInterrupt

    @contextmanager
    def attached(self) -> Iterator[None]:
        """Route SIGINT here for a whole process, unless it is ignored, as in the background of a script.

        Afterwards it is ignored: nothing disturbs how Python leaves.
        """
        self.came = False
        if signal.getsignal(signal.SIGINT) in {signal.default_int_handler, signal.SIG_DFL}:
            signal.signal(signal.SIGINT, self.pressed)
        try:
            yield
        finally:
            signal.signal(signal.SIGINT, signal.SIG_IGN)


OF_THIS_PROCESS = Interrupts()


@contextmanager
def one_line_of_interrupt() -> Iterator[None]:
    """Turn a KeyboardInterrupt into one line and exit code INTERRUPTED.

    The text of the exception tells what there is: a log, as far as it goes.
    """
    try:
        yield
    except (SystemExit, click.exceptions.Exit, click.ClickException):
        raise
    except BaseException as error:
        if not (isinstance(error, KeyboardInterrupt) or OF_THIS_PROCESS.came):
            raise
        from hil.app.terminal import visible

        there = f" {error}" if isinstance(error, KeyboardInterrupt) and str(error) else ""
        below = "\n" if sys.stderr.isatty() else ""  # of a terminal's ^C
        click.echo(visible(f"{below}hil: interrupted{there}"), err=True)
        sys.exit(INTERRUPTED)
