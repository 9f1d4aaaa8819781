"""Standard output that nobody reads any more, as that of `hil check | head -1`: a quiet end, no message."""

import os
import select
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager

NOBODY_READS = 128 + signal.SIGPIPE
"""Exit code: what a shell shows of a tool that SIGPIPE has ended."""
_STANDARD = (1, 2)
"""Output and error."""


def reader_gone() -> bool:
    """Return whether standard output or standard error is a pipe whose reader has closed it."""
    poll = select.poll()
    for number in _STANDARD:
        poll.register(number, 0)
    return any(events & select.POLLERR for _, events in poll.poll(0))


@contextmanager
def quiet_pipe() -> Iterator[None]:
    """Exit with NOBODY_READS where something was to be printed and its reader has gone."""
    try:
        try:
            yield
        finally:
            sys.stdout.flush()
    except BrokenPipeError:
        if not reader_gone():  # the pipe to another process
            raise
        _leave()


def _leave() -> None:
    """Exit; what is still to be written goes nowhere, so that the interpreter's last flush does not fail."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for number in _STANDARD:
        os.dup2(nowhere, number)
    os.close(nowhere)
    sys.exit(NOBODY_READS)
