"""Keys of a configuration as words, `plant.faults[0].mass_kg`, and what an axis puts there."""

import copy
import re
from collections.abc import Callable
from functools import partial
from itertools import pairwise
from typing import Any

from drivers.errors import ConfigurationError
from hil.app.configuration.changes import merged
from hil.app.configuration.fault_words import read_fault
from hil.app.configuration.yaml_positions import path_text
from hil.study.campaign.settings import ListedAxis

SEED = "seed"
"""The key that is no section: what varies all chance of the plant's end."""
Data = dict[str, Any]
_FAULTS = ("plant", "faults")
_WORD = re.compile(r"([A-Za-z_][A-Za-z0-9_]*)((?:\[[0-9]+\])*)")


def path(key: str) -> tuple[str | int, ...]:
    """Return names and indices of a key. Raises ConfigurationError: not of that form."""
    found: list[str | int] = []
    for part in key.split("."):
        match = _WORD.fullmatch(part)
        if match is None:
            raise ConfigurationError(
                f"{key}: no key, allowed: names with dots and indices, as plant.faults[0].mass_kg"
            )
        found += [match[1], *map(int, re.findall("[0-9]+", match[2]))]
    return tuple(found)


def at(data: Any, place: tuple[str, ...]) -> Any:
    """Return what is at a place of plain data; None: nothing."""
    for name in place:
        data = data.get(name) if isinstance(data, dict) else None
    return data


def apply(value: Data, axes: dict[str, ListedAxis], values: Data) -> Data:
    """Return the data of a configuration with values of a row: options, then faults, then keys.

    Of keys that reach into each other the outer ones come first, whatever their order in the file: those that
    bring `plant.faults` before the faults of an axis.

    Raises ConfigurationError: words that are no fault, a key that fits nothing.
    """
    steps: list[tuple[tuple[int, int], Callable[[Data], Data]]] = []
    for name, given in values.items():
        axis = axes[name]
        if axis.options is not None:
            steps.append(((0, 0), partial(merged, changes=axis.options[given])))
        if axis.faults is not None:
            steps.append(((2, 0), partial(_with_faults, words=axis.faults[given])))
        for key in axis.targets:
            if key != SEED:
                place = path(key)
                brings_faults = place == _FAULTS[: len(place)]
                steps.append(((1 if brings_faults else 3, len(place)), partial(put, key=key, given=given)))
    for _, step in sorted(steps, key=lambda each: each[0]):
        value = step(value)
    return value


def _with_faults(value: Data, words: list[str]) -> Data:
    """Return data with more faults."""
    more = [read_fault(each).model_dump(mode="json", exclude_unset=True) for each in words]
    return merged(value, {"plant": {"faults": [*(at(value, _FAULTS) or []), *more]}})


def put(value: Data, key: str, given: Any) -> Data:
    """Set a key, and return the same data; sections above it that are missing are made.

    Raises ConfigurationError: a part of the key is no section or no list, or the list is too short.
    """
    parts = path(key)
    place: Any = value
    for n, (item, below) in enumerate(pairwise(parts), 1):
        empty: Any = {} if isinstance(below, str) else []
        place = place.setdefault(item, empty) if isinstance(item, str) else place[item]
        so_far = path_text(parts[:n])
        if not isinstance(place, type(empty)):
            raise ConfigurationError(f"{key}: {so_far} is a value, allowed: a section or a list that has it")
        if isinstance(below, int) and below >= len(place):
            raise ConfigurationError(
                f"{key}: {so_far} has no entry {below}, it has {len(place)}; give it one in `changes` of the "
                "campaign"
            )
    place[parts[-1]] = copy.deepcopy(given)  # another axis may reach into it
    return value
