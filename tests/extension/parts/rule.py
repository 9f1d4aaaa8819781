"""Safety rule for the height of the platform under a ceiling."""

from __future__ import annotations

from drivers.compiled.compiler import helper

CEILING_m = 1.15


@helper
def too_high(z: float) -> bool:
    """True if the platform origin is above the ceiling; z m in the base frame."""
    return not z <= CEILING_m
