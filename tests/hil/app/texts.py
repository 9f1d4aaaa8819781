"""Text of a configuration with parts replaced, each of which occurs in it exactly once."""

from __future__ import annotations

from hil.app.configuration.configuration import load

VIRTUAL = load("virtual").text


def edited(*changes: tuple[str, str], base: str = VIRTUAL) -> str:
    """The text with each (old, new) replaced."""
    for old, new in changes:
        assert base.count(old) == 1, old
        base = base.replace(old, new)
    return base
