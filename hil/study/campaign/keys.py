"""Configuration keys, e.g. `plant.faults[0].mass_kg`, and the values that swept axes set there."""

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
"""Key outside all sections: seed of all randomness at the plant's end of the bus."""
Data = dict[str, Any]
_FAULTS = ("plant", "faults")
_WORD = re.compile(r"([A-Za-z_][A-Za-z0-9_]*)((?:\[[0-9]+\])*)")


def path(key: str) -> tuple[str | int, ...]:
    """Section names and list indices of a key. Raises ConfigurationError if the key is malformed."""
    found: list[str | int] = []
    for part in key.split("."):
        match = _WORD.fullmatch(part)
        if match is None:
            raise ConfigurationError(
                f"{key}: malformed key, allowed: names with dots and indices, as plant.faults[0].mass_kg"
            )
        found += [match[1], *map(int, re.findall("[0-9]+", match[2]))]
    return tuple(found)


def at(data: Any, place: tuple[str, ...]) -> Any:
    """Value at a sequence of keys in nested dictionaries; None if missing."""
    for name in place:
        data = data.get(name) if isinstance(data, dict) else None
    return data


def apply(value: Data, axes: dict[str, ListedAxis], values: Data) -> Data:
    """Set the axis values of a row in the data of a configuration: options, then faults, then keys.

    Outer keys are set before keys inside them, whatever their order in the file. Keys that contain
    `plant.faults` are set before the faults of an axis.

    Raises ConfigurationError: invalid fault, or a key that does not fit the data.
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
    more = [read_fault(each).model_dump(mode="json", exclude_unset=True) for each in words]
    return merged(value, {"plant": {"faults": [*(at(value, _FAULTS) or []), *more]}})


def put(value: Data, key: str, given: Any) -> Data:
    """Set a key in configuration data and return the data; missing sections above the key are created.

    Raises ConfigurationError: a part of the key is neither section nor list, or the list is too short.
    """
    parts = path(key)
    place: Any = value
    for n, (item, below) in enumerate(pairwise(parts), 1):
        empty: Any = {} if isinstance(below, str) else []
        place = place.setdefault(item, empty) if isinstance(item, str) else place[item]
        parent = path_text(parts[:n])
        if not isinstance(place, type(empty)):
            raise ConfigurationError(f"{key}: {parent} is a plain value, allowed: a section or a list")
        if isinstance(below, int) and below >= len(place):
            raise ConfigurationError(
                f"{key}: {parent} has no entry {below}, only {len(place)}; add it in `changes` of the "
                "campaign"
            )
    place[parts[-1]] = copy.deepcopy(given)  # another axis may change a part of it
    return value
