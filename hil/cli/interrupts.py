"""Handling of Ctrl-C in a command: open files are closed, one line is printed, the exit code is 130."""

import io
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any, TextIO

import click

INTERRUPTED = 128 + signal.SIGINT
"""Exit code that a shell reports for a process ended by SIGINT."""
BROKEN_PIPE = 141
"""Exit code that a shell reports for a process ended by SIGPIPE, as after `hil check | head -1`."""


def pressed(signum: int, frame: FrameType | None) -> None:
    """Raise KeyboardInterrupt at SIGINT or SIGTERM, unless the clean-up after an earlier one is under way."""
    del signum, frame
    if not isinstance(sys.exc_info()[1], KeyboardInterrupt):
        raise KeyboardInterrupt


class _Raw(io.FileIO):
    """Standard output or error that drops text it cannot write, so that no result is lost.

    Mutable state: the first error of a write.
    """

    trouble: OSError | None = None

    def write(self, data: Any) -> int:
        if self.trouble is None:
            try:
                return super().write(data)
            except OSError as error:
                self.trouble = error
        return memoryview(data).nbytes


def _dropping(stream: TextIO, raws: list[_Raw]) -> TextIO:
    """Replace a stream by one that accepts every character; return it unchanged if it is not a file."""
    buffer = getattr(stream, "buffer", None)
    if not isinstance(stream, io.TextIOWrapper) or not isinstance(buffer, io.BufferedWriter | io.FileIO):
        return stream
    stream.flush()
    raws.append(_Raw(stream.fileno(), "w", closefd=False))
    lines = stream.line_buffering or stream.write_through
    return io.TextIOWrapper(
        io.BufferedWriter(raws[-1]), stream.encoding, "backslashreplace", line_buffering=lines
    )


@contextmanager
def attached() -> Iterator[None]:
    """Install the signal handling and the output streams of the process.

    SIGINT and SIGTERM go to `pressed`, unless ignored, as in the background of a script. Afterwards SIGINT is
    ignored, so that Python exits undisturbed. Exits with BROKEN_PIPE or 1 if output could not be printed.
    """
    for number in (signal.SIGINT, signal.SIGTERM):
        if signal.getsignal(number) in {signal.default_int_handler, signal.SIG_DFL}:
            signal.signal(number, pressed)
    if isinstance(sys.stdin, io.TextIOWrapper):
        sys.stdin.reconfigure(errors="replace")
    before, raws = (sys.stdout, sys.stderr), list[_Raw]()
    sys.stdout, sys.stderr = (_dropping(stream, raws) for stream in before)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        if signal.getsignal(signal.SIGTERM) is pressed:
            signal.signal(signal.SIGTERM, signal.SIG_DFL)
        for stream in filter(None, (sys.stdout, sys.stderr)):  # None: closed by who started us
            stream.flush()
        sys.stdout, sys.stderr = before
        if trouble := next((raw.trouble for raw in raws if raw.trouble), None):
            if isinstance(trouble, BrokenPipeError):
                sys.exit(BROKEN_PIPE)
            click.echo(f"hil: standard output cannot be written: {trouble.strerror}", err=True)
            sys.exit(1)


@contextmanager
def one_line_of_interrupt() -> Iterator[None]:
    """Turn a KeyboardInterrupt, or a library's error caused by it, into one line and exit code INTERRUPTED.

    The text of the exception states what was saved: a log up to the interruption.
    """
    try:
        yield
    except (KeyboardInterrupt, Exception) as error:
        interrupt: BaseException | None = error
        while interrupt is not None and not isinstance(interrupt, KeyboardInterrupt):
            interrupt = interrupt.__cause__ or interrupt.__context__
        if interrupt is None:
            raise
        from hil.app.terminal import visible

        below = "\n" if sys.stderr.isatty() else ""  # of a terminal's ^C
        click.echo(visible(f"{below}hil: interrupted {interrupt}".rstrip()), err=True)
        sys.exit(INTERRUPTED)
