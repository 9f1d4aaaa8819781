"""The operator at a terminal: Enter confirms an action, a number is a reading, a word accepts a risk.

`no`, or the end of the input, ends the bring-up. Lines typed ahead are kept for the next question.
"""

import contextlib
import math
import os
import select
import sys
from collections.abc import Callable
from typing import TextIO

from hil.lab.bringup.context import RefusedError, Request

_CHUNK = 4096


def _how(request: Request) -> str:
    if request.within is not None:
        return "type the number"
    return f"type `{request.word}`" if request.word else "then Enter"


class Terminal:
    """Asks the operator on a terminal without delaying a tick. Mutable state: the question, typed bytes."""

    patience = math.inf

    def __init__(self, write: Callable[[str], None], source: TextIO | None = None) -> None:
        self._write = write
        self._source = sys.stdin if source is None else source
        self._open: Request | None = None
        self._typed = b""
        self._ended = False

    def tell(self, text: str) -> None:
        """Show a text to the operator."""
        self._write(text)

    def consent(self, title: str, will: str, stop: str) -> bool:
        """Wait for Enter before a step, with no drive powered. Raises RefusedError if the answer is no."""
        how = f"Enter begins {title}, `no` ends"
        self._write(f"  it {will}\n  to stop it: {stop}\n  {how}")
        while typed := self._line():
            self._write(f"  {typed!r} is not an answer: {how}")
        return True

    def ask(self, request: Request) -> None:
        """Show the requested action or reading; `answer` polls for the reply."""
        self._open = request
        self._write(f"    {request.text}; {_how(request)}")

    def answer(self) -> float | None:
        """The number typed, 0 for an action done, None until then. Raises RefusedError for `no`."""
        while not self._whole() and select.select([self._source], [], [], 0.0)[0]:
            self._take()
        if not self._whole():
            return None
        assert self._open is not None
        typed, value = self._line(), math.nan
        if self._open.within is None:
            value = 0.0 if typed == self._open.word else math.nan
        else:
            with contextlib.suppress(ValueError):
                value = float(typed.replace(",", ".") if "." not in typed else typed)
        if not math.isfinite(value):
            self._write(f"    {typed!r} is not an answer; {self._open.text}; {_how(self._open)}")
            return None
        if "," in typed:
            self._write(f"    read as {value:g}")
        return value

    def _whole(self) -> bool:
        return b"\n" in self._typed or self._ended

    def _line(self) -> str:
        while not self._whole():
            self._take()
        line, newline, self._typed = self._typed.partition(b"\n")
        typed = line.decode(errors="replace").strip().lower()
        if (not newline and not typed) or typed in ("no", "n", "q", "quit"):
            raise RefusedError("ended by the operator; results so far are kept")
        return typed

    def _take(self) -> None:
        try:
            chunk = os.read(self._source.fileno(), _CHUNK)
        except (OSError, ValueError):
            chunk = b""
        self._typed += chunk
        self._ended = not chunk
