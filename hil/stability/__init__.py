"""Stability: proofs about equilibria, and what a law's error dynamics promise.

Rule of the room: offline. Names are looked up when asked for, so that importing the package loads no algebra.
"""

from __future__ import annotations

from typing import Any

__all__ = ["Budget", "Report", "verify"]


def __getattr__(name: str) -> Any:
    """Load the verifier with the first of its names."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from hil.stability import verifier  # noqa: PLC0415 - sympy and flint take most of a second

    return getattr(verifier, name)
