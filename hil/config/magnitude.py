"""Which numbers are meant: others, squared or divided by, would leave what a float holds."""

LEAST, MOST = 1e-60, 1e15
"""Of a number that is not 0, in any unit; rounding may leave 1e-17 or less of a zero."""
ALLOWED = f"0, and {LEAST:g} to {MOST:g}"
"""What is allowed in size, as a refusal says it."""


def in_reason(number: float) -> bool:
    """Tell whether a number, which may be none, is one that is meant."""
    return number == 0.0 or LEAST <= abs(number) <= MOST
