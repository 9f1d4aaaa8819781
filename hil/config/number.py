"""Numbers in text, and their allowed range: the square of a number outside would not fit into a float."""

import math
import re

LEAST, MOST = 1e-60, 1e15
"""Allowed magnitude of a number other than 0, in any unit; rounding may leave 1e-17 or less of a zero."""
ALLOWED = f"0, and {LEAST:g} to {MOST:g}"
"""Allowed magnitudes, as text for messages."""

_PLAIN = re.compile(r"[+-]?(?:[0-9]+[.]?[0-9]*|[.][0-9]+)(?:[eE][+-]?[0-9]+)?")


def is_allowed(number: float) -> bool:
    """True for 0 and for numbers within the allowed magnitudes; False for nan."""
    return number == 0.0 or LEAST <= abs(number) <= MOST


def plain_number(word: str) -> float:
    """Decimal number in `word`; nan for any other text, such as 1_0 or digits of other scripts."""
    return float(word) if _PLAIN.fullmatch(word.strip()) else math.nan
