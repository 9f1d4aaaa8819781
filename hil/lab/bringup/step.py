"""What a step of the bring-up is."""

from collections.abc import Callable
from typing import NamedTuple

from drivers.signals import LEGS
from hil.lab.bringup.context import Context, Finding, Gap


def no_gap(_c: Context) -> Gap | None:
    """Return None: all of the step is proven."""
    return None


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
    by_drive: bool = False
    """It finds a fact of each drive."""
    gap: Callable[[Context], Gap | None] = no_gap
    """What it cannot prove with these drives, by the facts; it has not passed then."""
    tables: tuple[str, ...] = ()
    """Where it keeps its facts, if not under its own name."""

    def measured(self, c: Context) -> bool:
        """Tell whether all that the step is to find has been found."""
        return not self.by_drive or len(c.facts.get(self.name, {})) == LEGS

    def kept_whole(self, c: Context, many: int) -> bool:
        """Tell whether it has passed before, and none of its facts, `many` in each table, is lost since."""
        passed = self.kept and self.name in c.facts.get("passed", {})
        return passed and all(len(c.facts.get(table, {})) == many for table in self.tables or (self.name,))
