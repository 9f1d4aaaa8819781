"""What an answer may cost: cells, the same on every machine, and seconds, for what has no cells.

Algebra has no cells, and some of it has no end that anybody waits for. So the clock interrupts it, and what
was shown before stays shown: a proof is never half used.
"""

import math
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from time import monotonic
from typing import Any, TypeVar

from drivers.errors import ModelError

Answer = TypeVar("Answer")


class OutOfTime(BaseException):
    """The seconds ended. No Exception: algebra that catches all of these must not catch this."""


class Budget:
    """How many cells may be looked at, and for how many seconds; counts down.

    Mutable: `left` goes down, `ended` says that more was asked for than there was.
    `seconds` are those of each call of `verify`, on the wall; math.inf leaves the count of cells alone, so
    that a proof found once is found on every machine.
    """

    def __init__(self, boxes: int = 40_000, seconds: float = 15.0) -> None:
        if isinstance(boxes, bool) or not isinstance(boxes, int) or boxes < 0 or not seconds > 0:
            raise ModelError(
                f"a budget of {boxes!r} boxes and {seconds!r} s: a whole number and a positive one are needed"
            )
        self.seconds = seconds
        self.left = boxes
        self.ended = False
        self._began = self._end = math.inf

    def start(self) -> None:
        """Begin to count the seconds."""
        self._began = monotonic()
        self._end = self._began + self.seconds

    def take(self) -> bool:
        """Take one cell; tell whether there was one."""
        if self.left <= 0 or monotonic() > self._end:
            self.ended = True
            return False
        self.left -= 1
        return True

    def within(self, share: float, question: Callable[[], Answer], otherwise: Answer) -> Answer:
        """Return what `question` returns, or `otherwise` if that share of all the seconds ends before.

        A question does not ask another one this way.
        """
        left = share * self.seconds - (monotonic() - self._began) if math.isfinite(self.seconds) else math.inf
        try:
            with _interrupted(left):
                return question()
        except OutOfTime:
            self.ended = True
            return otherwise


@contextmanager
def _interrupted(seconds: float) -> Iterator[None]:
    """Raise OutOfTime in what is done here when the seconds end; outside the main thread only cells look."""
    if seconds <= 0:
        raise OutOfTime
    armed = [True]

    def ring(*_: Any) -> None:
        if armed:
            raise OutOfTime

    try:
        before = signal.signal(signal.SIGALRM, ring)
    except (AttributeError, ValueError):  # no alarm on this system, or in this thread
        yield
        return
    try:
        if math.isfinite(seconds):
            signal.setitimer(signal.ITIMER_REAL, seconds, 0.2)  # again and again: a finalizer may swallow one
        yield
    finally:
        armed.clear()
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
