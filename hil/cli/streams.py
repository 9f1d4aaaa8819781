"""Standard input, output and error of a process: they are there, take every sign, and fail at no print.

What a full disk, a terminal that has gone or a refused write lets nobody read ends no run and costs no
result: it is dropped, one line says so at the end, and the exit code is no success.
"""

import contextlib
import io
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, TextIO

import click

_LOST = 1
"""Exit code of a success that could not be printed."""


class Stream(io.FileIO):
    """Standard output or error. Mutable state: why what was written to it is lost, or empty."""

    def __init__(self, number: int) -> None:
        super().__init__(number, "w", closefd=False)
        self.trouble = ""

    def write(self, data: Any) -> int:
        """Write, or drop what cannot be written; a pipe that nobody reads is the caller's."""
        try:
            return super().write(data)
        except BrokenPipeError:
            raise
        except OSError as error:
            self.trouble = self.trouble or error.strerror or str(error)
            return memoryview(data).nbytes


@contextlib.contextmanager
def own_streams() -> Iterator[None]:
    """Be so for a whole process, which ends with SystemExit."""
    before = sys.stdin, sys.stdout, sys.stderr
    with contextlib.ExitStack() as opened:
        for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
            if getattr(sys, name) is None:  # closed: the next file that is opened would take its number
                setattr(sys, name, opened.enter_context(Path(os.devnull).open(mode)))
        if isinstance(sys.stdin, io.TextIOWrapper):
            with contextlib.suppress(io.UnsupportedOperation):  # read from before, as in a test
                sys.stdin.reconfigure(errors="replace")
        out, error = _taking(sys.stdout), _taking(sys.stderr)
        try:
            yield
        except SystemExit as end:
            _flush()
            for name, stream in (("output", out), ("error", error)):
                if stream is not None and stream.trouble:
                    click.echo(f"hil: standard {name} cannot be written: {stream.trouble}", err=True)
                    end.code = end.code or _LOST
            raise
        finally:
            _flush()
            sys.stdin, sys.stdout, sys.stderr = before


def _taking(stream: TextIO) -> Stream | None:
    """Put a Stream in the place of standard output or error; leave what is no file, as in a test."""
    if not isinstance(stream, io.TextIOWrapper) or not isinstance(
        stream.buffer, (io.BufferedWriter, io.FileIO)
    ):
        return None
    stream.flush()
    raw = Stream(stream.fileno())
    taking = io.TextIOWrapper(
        io.BufferedWriter(raw),
        encoding=stream.encoding,
        errors="backslashreplace",
        line_buffering=stream.line_buffering or stream.write_through,
    )
    setattr(sys, "stdout" if stream is sys.stdout else "stderr", taking)
    return raw


def _flush() -> None:
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError):
            stream.flush()
