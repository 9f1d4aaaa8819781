"""A line on a terminal that the next one rewrites: where it wraps, each one leaves a row behind."""

import contextlib
import os
from typing import TextIO

_COLUMNS = 80
"""Of a terminal that does not say how wide it is."""


def rewriting(text: str, out: TextIO) -> str:
    """Return what writes a text over the line that is there, cut to the width that the terminal has now."""
    columns = 0
    with contextlib.suppress(OSError):
        columns = os.get_terminal_size(out.fileno()).columns
    return f"\r\x1b[K{text[: (columns or _COLUMNS) - 1]}"
