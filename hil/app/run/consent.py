"""Reads the operator's consent to motion at the terminal: the Enter key."""

import os
import select
from collections.abc import Callable

from drivers.errors import RunError

_LONGEST = 1024


class EnterKey:
    """Enter key of the terminal, which counts while this process runs in its foreground.

    Mutable state: whether the first call has discarded earlier input; whether the terminal has closed.
    """

    def __init__(self, hung_up: Callable[[], None], fd: int = 0) -> None:
        """fd: the terminal. hung_up: called once when the terminal has closed.

        Raises RunError: fd is not a terminal, or this process is not in its foreground.
        """
        try:
            ours = os.isatty(fd) and os.tcgetpgrp(fd) == os.getpgrp()
        except OSError:
            ours = False
        if not ours:
            raise RunError(
                "the platform moves only with the operator's consent, and there is no terminal to press "
                "Enter in: add --arm, or --wait-for-arm and run `hil ctl CONFIG arm`"
            )
        self._fd = fd
        self._hung_up = hung_up
        self._poll = select.poll()
        self._poll.register(fd, select.POLLIN)
        self._asked = self._gone = False

    def pressed(self) -> bool:
        """True if Enter was pressed since the last call. The first call discards earlier input."""
        if self._gone:
            return False
        import termios  # noqa: PLC0415 - not on Windows

        try:
            if not self._asked:
                self._asked = True
                termios.tcflush(self._fd, termios.TCIFLUSH)
                return False
            if not self._poll.poll(0):
                return False
            typed = os.read(self._fd, _LONGEST)
        except (OSError, termios.error):
            typed = b""
        self._gone = not typed
        if self._gone:
            self._hung_up()
        return b"\n" in typed
