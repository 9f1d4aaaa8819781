"""What an answer may cost: cells, the same on every machine, and seconds, for what has no cells.

Algebra has no cells, and some of it has no end that anybody waits for. So the clock interrupts it, and what
was shown before stays shown: a proof is never half used.
"""

import math
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from time import monotonic
from typing import Any, TypeVar

from drivers.errors import ModelError

Answer = TypeVar("Answer")


class OutOfTime(BaseException):
    """The seconds ended. No Exception: algebra that catches all of these must not catch this.

    `again` is called where a finalizer swallowed it.
    """

    def __init__(self, again: Callable[[], None] = lambda: None) -> None:
        super().__init__()
        self.again = again


class Budget:
    """How many cells may be looked at, and for how many seconds; counts down.

    Mutable: `left` goes down, `ended` says that more was asked for than there was, `late` that it was time.
    `seconds` are those of each call of `verify`, on the wall; math.inf leaves the count of cells alone, so
    that a proof found once is found on every machine.
    """

    def __init__(self, boxes: int = 40_000, seconds: float = 15.0) -> None:
        if isinstance(boxes, bool) or not isinstance(boxes, int) or boxes < 0 or not seconds > 0:
            raise ModelError(
                f"a budget of {boxes!r} boxes and {seconds!r} s: a whole number and a positive one are needed"
            )
        self.boxes = boxes
        self.seconds = seconds
        self.left = boxes
        self.ended = False
        self.late = False
        self._began = self._end = math.inf

    def start(self) -> None:
        """Begin to count the seconds."""
        self._began = monotonic()
        self._end = self._began + self.seconds
        self.late = False

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
            self.ended = self.late = True
            return otherwise


@contextmanager
def _interrupted(seconds: float) -> Iterator[None]:
    """Raise OutOfTime in what is done here when the seconds end."""
    if seconds <= 0:
        raise OutOfTime
    if math.isinf(seconds):
        yield
        return
    armed = [True]

    def ring(*_: Any) -> None:
        if armed:
            raise OutOfTime

    try:
        if signal.getitimer(signal.ITIMER_REAL)[0] > 0:
            raise ValueError("somebody else waits for the alarm")  # noqa: TRY301
        before = signal.signal(signal.SIGALRM, ring)
    except (AttributeError, ValueError):  # no alarm on this system, in this thread, or a taken one
        with _watched(monotonic() + seconds):
            yield
        return
    try:
        signal.setitimer(signal.ITIMER_REAL, seconds, 0.2)  # again and again: one may be lost in a finalizer
        try:
            with _unlost():
                yield
        finally:
            armed.clear()
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


@contextmanager
def _watched(end: float) -> Iterator[None]:
    """Raise OutOfTime at the first call of a function after the end: slower, and in any thread."""

    def look(_: Any, event: str, __: Any) -> None:
        if event in {"call", "c_call"} and monotonic() > end:
            raise OutOfTime(lambda: sys.setprofile(look))  # one that raises is taken away

    if sys.getprofile() is not None:  # cells alone are counted under somebody else's profiler
        yield
        return
    sys.setprofile(look)
    try:
        with _unlost():
            yield
    finally:
        sys.setprofile(None)


@contextmanager
def _unlost() -> Iterator[None]:
    """Let no finalizer end the wait: what was raised in one goes nowhere, so it is raised once more."""
    before = sys.unraisablehook

    def hook(lost: Any) -> None:
        if isinstance(lost.exc_value, OutOfTime):
            lost.exc_value.again()
        else:
            before(lost)

    sys.unraisablehook = hook
    try:
        yield
    finally:
        sys.unraisablehook = before
