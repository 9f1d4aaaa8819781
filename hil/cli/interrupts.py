"""Ctrl-C in a command: what was begun is closed, one line reports it, exit code 130."""

import io
import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

import click

INTERRUPTED = 128 + signal.SIGINT
"""Exit code: what a shell shows of a tool that SIGINT has ended."""
NOBODY_READS = 128 + signal.SIGPIPE
"""Exit code: the same for SIGPIPE, as after `hil check | head -1`."""


def pressed(signum: int, frame: FrameType | None) -> None:
    """Raise KeyboardInterrupt, unless one is on its way: files are being closed and processes ended."""
    del signum, frame
    if not isinstance(sys.exc_info()[1], KeyboardInterrupt):
        raise KeyboardInterrupt


@contextmanager
def attached() -> Iterator[None]:
    """Be the signals and the output of a whole process.

    SIGINT goes to `pressed`, unless it is ignored, as in the background of a script; afterwards it is
    ignored: nothing disturbs how Python leaves. What cannot be printed ends with an exit code.
    """
    if signal.getsignal(signal.SIGINT) in {signal.default_int_handler, signal.SIG_DFL}:
        signal.signal(signal.SIGINT, pressed)
    for stream, errors in ((sys.stdin, "replace"), (sys.stdout, "backslashreplace")):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors=errors)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        try:
            sys.stdout.flush()
        except OSError as error:
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            if isinstance(error, BrokenPipeError):
                sys.exit(NOBODY_READS)
            click.echo(f"hil: standard output cannot be written: {error.strerror}", err=True)
            sys.exit(1)


@contextmanager
def one_line_of_interrupt() -> Iterator[None]:
    """Turn a KeyboardInterrupt into one line and exit code INTERRUPTED.

    The text of the exception tells what there is: a log, as far as it goes.
    """
    try:
        yield
    except KeyboardInterrupt as error:
        from hil.app.terminal import visible

        below = "\n" if sys.stderr.isatty() else ""  # of a terminal's ^C
        click.echo(visible(f"{below}hil: interrupted {error}".rstrip()), err=True)
        sys.exit(INTERRUPTED)
