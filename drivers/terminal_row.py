"""A terminal line that the next one overwrites; a wrapped line would leave rows behind."""

import contextlib
import os
from typing import TextIO

_COLUMNS = 80
"""Width of a terminal that reports none."""


def rewriting(text: str, out: TextIO) -> str:
    """Text that overwrites the present line, cut to the present width of the terminal."""
    columns = 0
    with contextlib.suppress(OSError):
        columns = os.get_terminal_size(out.fileno()).columns
    return f"\r\x1b[K{text[: (columns or _COLUMNS) - 1]}"
