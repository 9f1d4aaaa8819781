"""What can be proven of a loop: error dynamics, ultimate bounds, energy, reaching, the sampled loop.

This file imports nothing before it is asked for: each question is a module of its own, and some are heavy.
"""

from typing import Any

__all__ = ["Budget", "Report", "verify"]


def __getattr__(name: str) -> Any:
    """Load the verifier with the first of its names."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from hil.stability import verifier  # noqa: PLC0415 - sympy and flint take most of a second

    return getattr(verifier, name)
