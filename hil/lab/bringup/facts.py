"""Which facts of a bring-up are about a leg, and how they are dropped."""

from collections.abc import Collection
from typing import Any

BY_LEG = ("ids", "encoder", "held", "opens", "force", "gauge", "watchdog")
"""Steps whose facts are about one leg, or its drive."""
_OTHERS = {"ids": "drives", "encoder": "drive", "opens": "legs"}
"""Where facts by leg name the drives that count it, and facts by drive the legs that it frees."""


def forget_legs(facts: dict[str, dict[str, Any]], legs: Collection[int]) -> None:
    """Drop the facts about legs or their drives, those about the platform, and that steps have passed.

    Behind exchanged numbers a fact's own leg is another: what names a leg or its drive goes, too.
    """
    gone = set(map(str, legs))
    for step in BY_LEG:
        _forget(facts.get(step, {}), gone, _OTHERS.get(step))
    facts.pop("mounted", None)
    facts.pop("load", None)
    facts.pop("passed", None)


def _forget(facts: dict[str, Any], gone: set[str], key: str | None) -> None:
    for name, fact in list(facts.items()):
        named = fact.get(key) if key else None
        others = named if isinstance(named, list) else [named]
        if not gone.isdisjoint({name, *map(str, others)}):
            del facts[name]
