"""Standard output and error of a process: no print fails at a full disk or a terminal that has gone.

What cannot be written is dropped, and costs no result: one line reports it at the end, and the exit code is
no success. A pipe without a reader, as that of `hil check | head -1`, ends the command quietly.
"""

import contextlib
import io
import signal
import sys
from collections.abc import Iterator
from typing import Any, TextIO

import click

NOBODY_READS = 128 + signal.SIGPIPE
"""Exit code: what a shell shows of a tool that SIGPIPE has ended."""
_LOST = 1
"""Exit code of a success that could not be printed."""


class Stream(io.FileIO):
    """Standard output or error. Mutable state: why what is written to it is lost, or empty."""

    def __init__(self, number: int) -> None:
        super().__init__(number, "w", closefd=False)
        self.trouble = ""

    def write(self, data: Any) -> int:
        """Write; what fails is dropped. Raises SystemExit, once, for a pipe without a reader."""
        try:
            if not self.trouble:
                return super().write(data)
        except OSError as error:
            self.trouble = error.strerror or str(error)
            if isinstance(error, BrokenPipeError):
                sys.exit(NOBODY_READS)
        return memoryview(data).nbytes


@contextlib.contextmanager
def own_streams() -> Iterator[None]:
    """Give a process such streams, which take every character; it ends with SystemExit."""
    before = sys.stdout, sys.stderr
    if isinstance(sys.stdin, io.TextIOWrapper):
        sys.stdin.reconfigure(errors="replace")
    (sys.stdout, out), (sys.stderr, error) = _taking(sys.stdout), _taking(sys.stderr)
    try:
        try:
            yield
        finally:
            for stream in filter(None, (sys.stdout, sys.stderr)):
                stream.flush()
    except SystemExit as end:
        for name, raw in (("output", out), ("error", error)):
            if raw is not None and raw.trouble and end.code != NOBODY_READS:
                click.echo(f"hil: standard {name} cannot be written: {raw.trouble}", err=True)
                end.code = end.code or _LOST
        raise
    finally:
        sys.stdout, sys.stderr = before


def _taking(stream: TextIO) -> tuple[TextIO, Stream | None]:
    """Make what takes the place of standard output or error; leave what is no file, as in a test."""
    if not isinstance(stream, io.TextIOWrapper) or not isinstance(
        stream.buffer, (io.BufferedWriter, io.FileIO)
    ):
        return stream, None
    stream.flush()
    raw = Stream(stream.fileno())
    lines = stream.line_buffering or stream.write_through
    taking = io.TextIOWrapper(
        io.BufferedWriter(raw), stream.encoding, "backslashreplace", line_buffering=lines
    )
    return taking, raw
