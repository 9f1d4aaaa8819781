"""What packages register by entry point: laws, protocols, emulated drives, plants. Ours do the same.

::

    [project.entry-points."hil.laws"]        # pyproject.toml of any installed package
    mine = "my_package.law:MySettings"
"""

from __future__ import annotations

from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from drivers.errors import ConfigurationError


@cache
def registered(group: str) -> dict[str, EntryPoint]:
    """Entry points of a group by name, in the order of their names.

    Raises ConfigurationError where two packages register the same name.
    """
    found: dict[str, EntryPoint] = {}
    for entry in sorted(_all().select(group=group), key=lambda each: each.name):
        other = found.setdefault(entry.name, entry)
        if other.value != entry.value:
            raise ConfigurationError(
                f"{group}: {entry.name} is registered as {other.value} (package {_package(other)}) and as "
                f"{entry.value} (package {_package(entry)}); uninstall one of them"
            )
    return found


@cache
def _all() -> Any:
    return entry_points()


def loaded(group: str, name: str) -> Any:
    """Object behind an entry point. Raises ConfigurationError where its package cannot be imported."""
    entry = registered(group)[name]
    try:
        return entry.load()
    except Exception as error:
        raise ConfigurationError(
            f"{group}: {name} = {entry.value} of package {_package(entry)} cannot be loaded: "
            f"{type(error).__name__}: {error}; correct the package, or uninstall it"
        ) from error


def _package(entry: EntryPoint) -> str:
    return "?" if entry.dist is None else entry.dist.name
