"""Rounding to a few significant digits, for values that a command proposes to the user."""

from math import ceil, floor, log10


def rounded(x: float, digits: int = 3) -> float:
    """Round to `digits` significant digits."""
    return 0.0 if x == 0.0 else float(f"{x:.{digits}g}")


def lowered(x: float, digits: int = 2) -> float:
    """Round x > 0 down to `digits` significant digits."""
    step = 10.0 ** (floor(log10(x)) - digits + 1)
    return rounded(floor(x / step + 1e-9) * step, digits)


def raised(x: float, digits: int = 2) -> float:
    """Round x > 0 up to `digits` significant digits."""
    step = 10.0 ** (floor(log10(x)) - digits + 1)
    return rounded(ceil(x / step - 1e-9) * step, digits)
