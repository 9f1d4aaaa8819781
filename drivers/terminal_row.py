"""A status line in a terminal that each new text overwrites, cut to the terminal's width."""

import contextlib
import os
from typing import TextIO

_COLUMNS = 80
"""Width of a terminal that reports none."""


def rewriting(text: str, out: TextIO) -> str:
    """Text to print over the present line, cut to the terminal's width: a wrapped line would leave rows."""
    columns = 0
    with contextlib.suppress(OSError):
        columns = os.get_terminal_size(out.fileno()).columns
    return f"\r\x1b[K{text[: (columns or _COLUMNS) - 1]}"
