"""Fewer cases than all: a fixed design in which every two values of any two factors meet."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations, product
from typing import Any


def pairwise(*factors: Sequence[Any]) -> list[tuple[Any, ...]]:
    """Return the cases, always the same ones: each next one has the most pairs that none before has."""

    def pairs(case: tuple[int, ...]) -> set[Any]:
        return set(combinations(enumerate(case), 2))

    every = list(product(*(range(len(factor)) for factor in factors)))
    left: set[Any] = set().union(*map(pairs, every))
    cases: list[tuple[Any, ...]] = []
    while left:
        best = max(every, key=lambda case: len(pairs(case) & left))
        left -= pairs(best)
        cases.append(tuple(factor[k] for factor, k in zip(factors, best, strict=True)))
    return cases
