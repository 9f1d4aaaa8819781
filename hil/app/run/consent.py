"""The operator's word that the platform may move, at the terminal: Enter."""

import os
import select
import termios
from collections.abc import Callable

from drivers.errors import RunError

_LONGEST = 1024


class EnterKey:
    """Enter at the terminal that this process runs in the foreground of.

    Mutable state: whether it has been asked before; what was typed before that does not count. Whether the
    terminal is gone.
    """

    def __init__(self, hung_up: Callable[[], None], fd: int = 0) -> None:
        """Take the terminal of a file descriptor; `hung_up` is called once when it is gone.

        Raises RunError where nobody can press a key there.
        """
        try:
            ours = os.isatty(fd) and os.tcgetpgrp(fd) == os.getpgrp()
        except OSError:
            ours = False
        if not ours:
            raise RunError(
                "nothing moves without the operator's word, and there is no terminal to press Enter in: "
                "add --arm, or --wait-for-arm and say `hil ctl CONFIG arm`"
            )
        self._fd = fd
        self._hung_up = hung_up
        self._poll = select.poll()
        self._poll.register(fd, select.POLLIN)
        self._asked = self._gone = False

    def pressed(self) -> bool:
        """Tell whether Enter has been pressed since the last call; called in every tick that waits for it."""
        if self._gone:
            return False
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
