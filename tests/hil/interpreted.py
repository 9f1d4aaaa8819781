"""Rules of kernels as they are written."""

from __future__ import annotations

from typing import TypeVar

F = TypeVar("F")


def plain(function: F) -> F:
    """Return a rule as it is written: to compile it takes longer."""
    written: F = getattr(function, "py_func", function)
    return written
