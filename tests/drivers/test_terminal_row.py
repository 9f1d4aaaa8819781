"""A line that the next one rewrites is cut one short of the terminal's width, or of 80 where none is known."""

from __future__ import annotations

import io
import os
from typing import Any

import pytest

from drivers.terminal_row import rewriting


class Screen(io.StringIO):
    """A terminal. State: what is written."""

    def fileno(self) -> int:
        return 5


@pytest.mark.parametrize(("columns", "shown"), [(100, 99), (20, 19), (0, 79), (None, 79)])
def test_a_line_is_cut_to_the_width_of_the_terminal(monkeypatch, columns, shown):
    def size(number: int) -> Any:
        assert number == 5
        if columns is None:
            raise OSError("no terminal")
        return os.terminal_size((columns, 24))

    monkeypatch.setattr(os, "get_terminal_size", size)
    assert rewriting("x" * 200, Screen()) == "\r\x1b[K" + "x" * shown
    assert rewriting("short", Screen()) == "\r\x1b[Kshort"
