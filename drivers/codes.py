"""Numbers as codes of n bits over a range."""

from drivers.compiled.compiler import helper


@helper
def code(value: float, low: float, high: float, bits: int) -> int:
    """Return the code of a value, saturated at the ends."""
    x = min(max(value, low), high)
    return int((x - low) * ((1 << bits) - 1) / (high - low))


@helper
def value(number: int, low: float, high: float, bits: int) -> float:
    """Return the value of a code."""
    return number * (high - low) / ((1 << bits) - 1) + low
