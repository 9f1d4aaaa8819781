"""Changes that no test can notice, each with its argument, in `equivalent.json`."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

from tools.mutants.mutant import Mutant, mutants

FILE = Path(__file__).with_name("equivalent.json")
_PLACE = ("file", "where", "statement", "before", "after")


def equivalents(root: Path, file: Path = FILE) -> dict[tuple[str, ...], str]:
    """Return the argument of each place.

    Raises SystemExit where an entry matches no mutant of today's source: it has changed, so the argument may
    no longer hold.
    """

    @cache
    def places(name: str) -> frozenset[tuple[str, ...]]:
        source = root / name
        text = source.read_text(encoding="utf-8") if source.is_file() else ""
        return frozenset(m.place for m in mutants(name, text))

    arguments = {}
    for entry in json.loads(file.read_text(encoding="utf-8")):
        place = tuple(entry[name] for name in _PLACE)
        if not entry["because"] or place not in places(entry["file"]):
            raise SystemExit(
                f"{file.name}: {entry['file']}, {entry['where'] or 'module'}: {entry['before']!r} -> "
                f"{entry['after']!r} is no mutant of the source now; judge the place again, or remove it"
            )
        arguments[place] = entry["because"]
    return arguments


def is_equivalent(mutant: Mutant, arguments: dict[tuple[str, ...], str]) -> bool:
    """Tell whether a mutant is in the list."""
    return mutant.place in arguments
