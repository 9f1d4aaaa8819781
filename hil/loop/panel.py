"""The operator's signals: Ctrl-C, termination, and the loss of the terminal."""

import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from types import FrameType

from hil.signals import Operator


@contextmanager
def signals_to(handler: Callable[[int, FrameType | None], None]) -> Iterator[None]:
    """Route SIGINT, SIGTERM and SIGHUP to `handler` inside the block."""
    before = {s: signal.signal(s, handler) for s in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
    try:
        yield
    finally:
        for s, previous in before.items():
            signal.signal(s, previous)


class OperatorPanel:
    """The operator's signals, which wait for the next tick.

    The first SIGINT, SIGTERM or SIGHUP requests a controlled stop, a second one an emergency stop. While the
    drives hold a platform whose brakes are not proven closed, each requests a controlled stop only. Mutable
    state: numbers of received and of delivered signals.
    """

    def __init__(self) -> None:
        self.interrupts = 0
        self._answered = 0
        self._running = False

    def take(self, *, held: bool = False) -> tuple[Operator, ...]:
        """Stops requested by signals since the last call; held: only drive force holds the platform."""
        commands: tuple[Operator, ...] = ()
        while self._answered < self.interrupts:  # counted, not listed: a signal may strike between any two
            self._answered += 1
            commands += (Operator.STOP if self._answered == 1 or held else Operator.ESTOP,)
        return commands

    def interrupt(self, signum: int, frame: FrameType | None) -> None:
        """Count a signal; before the loop runs, raise KeyboardInterrupt unless one is being handled."""
        del signum, frame
        self.interrupts += 1
        if not self._running and not isinstance(sys.exc_info()[1], KeyboardInterrupt):
            raise KeyboardInterrupt

    def attached(self) -> AbstractContextManager[None]:
        """Route the signals to this panel. Until `running` they raise KeyboardInterrupt."""
        return signals_to(self.interrupt)

    def running(self) -> None:
        """Only count signals from now on: they take effect in a tick; after the last tick they have none."""
        self._running = True
