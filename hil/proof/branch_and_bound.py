"""Branch and bound: a property of every point of a region, shown cell by cell.

Only enclosures decide. Cells are halved until an enclosure decides them or the budget is spent.
"""

from collections.abc import Callable, Iterable, Sequence

from hil.proof.budget import Budget
from hil.proof.interval import Ball, Cell, Enclosure, ball

__all__ = ["Budget", "covered", "faces", "halves", "middle", "positive", "without"]

SMALLEST = 2.0**-40
"""Cells whose widest side is below are not halved: where an enclosure still says nothing, it never will."""


def covered(
    cells: Iterable[Cell], holds: Callable[[Sequence[Ball]], bool], budget: Budget, limit: int = 10_000,
    fails: Callable[[Sequence[Ball]], bool] | None = None,
) -> bool:  # fmt: skip
    """Tell whether `holds` is true of every cell, halving those of which it is not.

    `holds` gets balls and must be true only if the property holds at each of their points. `fails` gets the
    middle of an undecided cell and ends the attempt where the property is false there. `limit` is the most
    that one attempt may take from the budget.
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
        if fails is not None and fails([ball(m, m) for m in middle(cell)]):
            return False
        stack.extend(halves(cell, widest))
    return True


def positive(
    functions: Sequence[Enclosure], cells: Iterable[Cell], budget: Budget, limit: int = 10_000
) -> bool:
    """Tell whether at each point of the cells at least one of the functions is shown to be > 0."""
    return covered(
        cells,
        lambda x: any(g(x) > 0 for g in functions),
        budget,
        limit,
        lambda x: all(g(x) <= 0 for g in functions),
    )


def middle(cell: Cell) -> list[float]:
    """Return the middle of a cell."""
    return [low + (high - low) / 2 for low, high in cell]


def halves(cell: Cell, side: int) -> tuple[Cell, Cell]:
    """Return the two halves of a cell across a side."""
    low, high = cell[side]
    m = low + (high - low) / 2
    return (*cell[:side], (low, m), *cell[side + 1 :]), (*cell[:side], (m, high), *cell[side + 1 :])


def faces(sides: Cell, moving: Sequence[int]) -> list[Cell]:
    """Return the faces of a cell: one of the sides `moving` at one of its ends."""
    return [(*sides[:k], (end, end), *sides[k + 1 :]) for k in moving for end in sides[k]]


def without(outer: Cell, inner: Cell) -> list[Cell]:
    """Return cells that cover `outer` without the interior of `inner`; slabs, one pair for each side."""
    slabs: list[Cell] = []
    rest = list(outer)
    for k, ((low, high), (inner_low, inner_high)) in enumerate(zip(outer, inner, strict=True)):
        for side in ((low, min(inner_low, high)), (max(inner_high, low), high)):
            if side[0] < side[1]:
                slabs.append((*rest[:k], side, *rest[k + 1 :]))
        rest[k] = (max(low, inner_low), min(high, inner_high))
    return slabs
