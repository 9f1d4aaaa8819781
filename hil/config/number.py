"""Which words are numbers, and which numbers are meant: others, squared, would leave what a float holds."""

import math
import re

LEAST, MOST = 1e-60, 1e15
"""Of a number that is not 0, in any unit; rounding may leave 1e-17 or less of a zero."""
ALLOWED = f"0, and {LEAST:g} to {MOST:g}"
"""What is allowed in size, as a refusal says it."""

_PLAIN = re.compile(r"[+-]?(?:[0-9]+[.]?[0-9]*|[.][0-9]+)(?:[eE][+-]?[0-9]+)?")


def in_reason(number: float) -> bool:
    """Tell whether a number, which may be none, is one that is meant."""
    return number == 0.0 or LEAST <= abs(number) <= MOST


def plain_number(word: str) -> float:
    """Return the number that a word spells, nan for what is none: not 1_0, nor digits of other scripts."""
    return float(word) if _PLAIN.fullmatch(word.strip()) else math.nan
