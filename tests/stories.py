"""The story of a cycle whose fault has struck in its last tick, for tests."""

from __future__ import annotations

from hil.loop.cycle import Cycle
from hil.loop.story.narrator import Narrator


def fault_text(cycle: Cycle) -> str:
    """Return the faults of the last tick and what shows them, in one line."""
    narrator = Narrator(cycle)
    narrator.look()
    return narrator.short
