"""What a step of the bring-up is."""

from collections.abc import Callable
from typing import NamedTuple

from hil.bringup.context import Context, Finding


class Step(NamedTuple):
    """One step: said before it is done, judged by what it measured."""

    name: str
    title: str
    will: str
    """What it will do."""
    stop: str
    """How to stop it."""
    find: Callable[[Context], None]
    """Finds the facts that are not known yet. Raises StoppedError."""
    judge: Callable[[Context], list[Finding]]
    """Names what is wrong by the facts."""
    kept: bool = True
    """Once passed it is not done again for the same hardware."""
    gate: bool = True
    """A finding ends the bring-up here; else the next steps still look for its cause."""
