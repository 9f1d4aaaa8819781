"""The operator at a terminal: Enter for what is done, a number for what is read, `no` to end."""

import math
import select
import sys
from collections.abc import Callable
from typing import TextIO

from hil.bringup.context import RefusedError, Request

READINGS = frozenset({"measure", "read_gauge", "read_push"})


class Terminal:
    """Questions on a terminal, which never hold the drives' ticks up. Mutable state: the open question."""

    def __init__(self, write: Callable[[str], None], source: TextIO | None = None) -> None:
        self._write = write
        self._source = sys.stdin if source is None else source
        self._open: Request | None = None

    def tell(self, text: str) -> None:
        """Say what was found."""
        self._write(text)

    def consent(self, title: str, will: str, stop: str) -> bool:
        """Ask for Enter before a step; nothing is powered meanwhile."""
        self._write(f"  it {will}\n  to stop it: {stop}\n  Enter begins {title}, `no` ends")
        return self._line() == ""

    def ask(self, request: Request) -> None:
        """Show what is to be done or read."""
        self._open = request
        how = "type the number" if request.act in READINGS else "then Enter"
        self._write(f"    {request.text}; {how}")

    def answer(self) -> float | None:
        """Return the number typed, 0 for Enter; None as long as there is no line. Raises RefusedError."""
        if not select.select([self._source], [], [], 0.0)[0]:
            return None
        assert self._open is not None
        typed = self._line()
        if self._open.act not in READINGS:
            return 0.0
        try:
            value = float(typed)
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            self._write(f"    {typed!r} is no number; {self._open.text}")
            return None
        return value

    def _line(self) -> str:
        line = self._source.readline()
        typed = line.strip().lower()
        if not line or typed in ("no", "n", "q", "quit"):
            raise RefusedError("ended by the operator; what was found is kept")
        return typed
