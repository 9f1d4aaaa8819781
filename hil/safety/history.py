"""What a rule remembers of past ticks, as bits of one integer."""

from drivers.compiled.compiler import helper

HISTORY = 32
"""Ticks that are remembered."""


@helper
def ones(history: int) -> int:
    """Return how many of the lowest HISTORY bits are 1."""
    count = 0
    for k in range(HISTORY):
        count += (history >> k) & 1
    return count
