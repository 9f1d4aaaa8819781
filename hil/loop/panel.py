"""The operator's signals: Ctrl-C, and a terminal that goes."""

import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from types import FrameType

from hil.signals import Operator


@contextmanager
def signals_to(handler: Callable[[int, FrameType | None], None]) -> Iterator[None]:
    """Route the signals that ask for an end to `handler`."""
    before = {s: signal.signal(s, handler) for s in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
    try:
        yield
    finally:
        for s, previous in before.items():
            signal.signal(s, previous)


class OperatorPanel:
    """The operator's signals, which wait for the next tick.

    SIGINT, SIGTERM and SIGHUP ask for a controlled stop, a second one for an emergency stop. While the drives
    hold a platform whose brakes are not proven shut, none of them drops it.
    Mutable state: how many signals came and how many were handed out.
    """

    def __init__(self) -> None:
        self.interrupts = 0
        self._answered = 0
        self._running = False

    def take(self, *, held: bool = False) -> tuple[Operator, ...]:
        """Return the commands that have come since the last call; held: only force holds the platform."""
        commands: tuple[Operator, ...] = ()
        while self._answered < self.interrupts:  # counted, not listed: a signal may strike between any two
            self._answered += 1
            commands += (Operator.STOP if self._answered == 1 or held else Operator.ESTOP,)
        return commands

    def interrupt(self, signum: int, frame: FrameType | None) -> None:
        """Handle a signal: before the loop there is nothing to stop but the start, and that once."""
        del signum, frame
        self.interrupts += 1
        if not self._running and not isinstance(sys.exc_info()[1], KeyboardInterrupt):
            raise KeyboardInterrupt

    def attached(self) -> AbstractContextManager[None]:
        """Route the signals here. Until `running` they raise KeyboardInterrupt."""
        return signals_to(self.interrupt)

    def running(self) -> None:
        """From now on signals wait for the next tick, and for ever once there is none."""
        self._running = True
