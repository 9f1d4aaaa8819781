"""Branch and bound: prove a property on a region cell by cell, within a budget of cells and seconds.

Only enclosures decide. Cells are halved until an enclosure decides them or the budget ends. The number of
cells gives equal results on every machine. Seconds limit algebra, which has no cells and may take very long.
The clock interrupts algebra; earlier results stay valid, and no partial proof is used.
"""

import math
import signal
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from time import monotonic
from typing import Any, TypeVar

from drivers.errors import ModelError
from hil.proof.interval import Ball, Cell, ball

Answer = TypeVar("Answer")


class OutOfTime(BaseException):
    """Raised at the time limit; a BaseException, so that no `except Exception` in algebra catches it."""


class Budget:
    """Limits of a proof attempt: remaining number of cells, and wall time in seconds.

    Mutable: `left` counts down; `ended` is set when the budget was insufficient.
    `seconds` is the wall time of each call of `verify`. With math.inf only the cells are limited, so every
    machine finds the same proofs.
    """

    def __init__(self, boxes: int = 40_000, seconds: float = 15.0) -> None:
        if type(boxes) is not int or boxes < 0 or not seconds > 0:
            raise ModelError(f"budget of {boxes!r} boxes, {seconds!r} s, allowed: a whole number >= 0, > 0 s")
        self.seconds = seconds
        self.left = boxes
        self.ended = False
        self._began = self._end = math.inf

    def start(self) -> None:
        """Start the clock that `seconds` limits."""
        self._began = monotonic()
        self._end = self._began + self.seconds

    def take(self) -> bool:
        """Deduct one cell from the budget; False if no cell is left or the time is over."""
        if self.left <= 0 or monotonic() > self._end:
            self.ended = True
            return False
        self.left -= 1
        return True

    def within(self, share: float, question: Callable[[], Answer], otherwise: Answer) -> Answer:
        """Result of `question`, or `otherwise` as soon as this share of `seconds` has passed since `start`.

        Calls must not be nested.
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
    """Context that raises OutOfTime in its body at the time limit; without effect outside the main thread."""
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
        try:
            yield
        finally:
            armed.clear()
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


SMALLEST = 2.0**-40
"""Width below which a cell is not halved any more; an undecided enclosure there stays undecided."""


def covered(
    cells: Iterable[Cell], holds: Callable[[Sequence[Ball]], bool], budget: Budget, limit: int,
    fails: Callable[[Sequence[Ball]], bool] = lambda _: False,
) -> bool:  # fmt: skip
    """Prove a property on all cells: `holds` is true for each, or after halving for each of its parts.

    `holds` gets balls and must be true only if the property holds at each of their points. `fails` gets the
    middle of an undecided cell and ends the attempt if the property is false there. `limit` is the largest
    number of cells that one attempt takes from the budget.
    """
    stack = list(cells)
    while stack:
        limit -= 1
        if limit < 0 or not budget.take():
            budget.ended |= limit < 0
            return False
        cell = stack.pop()
        if holds([ball(*side) for side in cell]):
            continue
        widest = max(range(len(cell)), key=lambda k: cell[k][1] - cell[k][0]) if cell else 0
        if not cell or cell[widest][1] - cell[widest][0] < SMALLEST:
            return False
        if fails([ball(m, m) for m in middle(cell)]):
            return False
        stack.extend(halves(cell, widest))
    return True


def positive(
    functions: Sequence[Callable[[Sequence[Ball]], Ball]], cells: Iterable[Cell], budget: Budget, limit: int
) -> bool:
    """Prove that at each point of the cells at least one of the functions is > 0; False: no proof found."""
    fails = lambda x: all(g(x) <= 0 for g in functions)  # noqa: E731
    return covered(cells, lambda x: any(g(x) > 0 for g in functions), budget, limit, fails)


def middle(cell: Cell) -> list[float]:
    """Centre (n,) of a cell with n sides."""
    return [low + (high - low) / 2 for low, high in cell]


def halves(cell: Cell, side: int) -> tuple[Cell, Cell]:
    """Both halves of a cell, divided in the middle of the side with index `side`."""
    low, high = cell[side]
    m = low + (high - low) / 2
    return (*cell[:side], (low, m), *cell[side + 1 :]), (*cell[:side], (m, high), *cell[side + 1 :])


def faces(sides: Cell, moving: Sequence[int]) -> list[Cell]:
    """Faces of a cell: each of the sides with an index in `moving` fixed at one of its ends."""
    return [(*sides[:k], (end, end), *sides[k + 1 :]) for k in moving for end in sides[k]]


def without(outer: Cell, inner: Cell) -> list[Cell]:
    """Cells that together cover `outer` without the interior of `inner`."""
    slabs: list[Cell] = []
    rest = list(outer)
    for k, ((low, high), (inner_low, inner_high)) in enumerate(zip(outer, inner, strict=True)):
        for side in ((low, min(inner_low, high)), (max(inner_high, low), high)):
            if side[0] < side[1]:
                slabs.append((*rest[:k], side, *rest[k + 1 :]))
        rest[k] = (max(low, inner_low), min(high, inner_high))
    return slabs
