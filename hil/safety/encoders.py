"""Rules on encoders that the fused pose can do without, and on a pose that has become too uncertain.

Written so that a value that is not a number faults.
"""

from collections.abc import Sequence

LEGS = range(6)


def excused(lost: Sequence[bool], may_lose: Sequence[int], at_once: int) -> tuple[bool, ...]:
    """Return which lost legs the run may go on without: none where more than `at_once` are lost."""
    few = sum(lost) <= at_once
    return tuple(few and lost[leg] and leg in may_lose for leg in LEGS)


def contradicted(slipped: Sequence[bool], allowed: Sequence[bool]) -> bool:
    """Tell whether the encoder of a leg that has to be heard has slipped."""
    return any(slip and not fine for slip, fine in zip(slipped, allowed, strict=True))


def uncertain(doubt: float, limit: float) -> bool:
    """Tell whether a measure of doubt is above its limit: a standard deviation, m, or a time unaided, s."""
    return not doubt <= limit
