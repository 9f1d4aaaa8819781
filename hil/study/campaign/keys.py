"""Keys of a configuration as words, `plant.faults[0].mass_kg`, and what an axis puts there."""

import copy
import re
from itertools import pairwise
from typing import Any

from drivers.errors import ConfigurationError
from hil.app.configuration.changes import merged
from hil.app.configuration.fault_words import read_fault
from hil.study.campaign.settings import ListedAxis

SEED = "seed"
"""The key that is no section: what varies all chance of the plant's end."""
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


def keys(axis: ListedAxis) -> list[str]:
    """Return the keys that take an axis' value."""
    return [axis.key] if isinstance(axis.key, str) else axis.key or []


def put(value: dict[str, Any], key: str, given: Any) -> None:
    """Set a key; sections above it that are missing are made.

    Raises ConfigurationError: a part of the key is no section or no list, or the list is too short.
    """
    parts = path(key)
    place: Any = value
    done: tuple[str | int, ...] = ()
    for item, below in pairwise(parts):
        done = (*done, item)
        if isinstance(item, str):
            place = place.setdefault(item, {} if isinstance(below, str) else [])
        else:
            place = place[item]
        _fits(place, below, key, done)
    place[parts[-1]] = copy.deepcopy(given)  # another axis may reach into it


def apply(value: dict[str, Any], axes: dict[str, ListedAxis], values: dict[str, Any]) -> dict[str, Any]:
    """Return the data of a configuration with the values of a row: options, then faults, then keys.

    Of keys that reach into each other the outer ones come first, whatever their order in the file: those that
    bring `plant.faults` before the faults of an axis.

    Raises ConfigurationError: words that are no fault, a key that fits nothing.
    """
    for name, axis in axes.items():
        if axis.options is not None:
            value = merged(value, axis.options[values[name]])
    swept = [(path(key), key, name) for name, axis in axes.items() for key in keys(axis) if key != SEED]
    swept.sort(key=lambda each: len(each[0]))
    around, others = (
        [each for each in swept if _brings_faults(each[0]) is brings] for brings in (True, False)
    )
    for _, key, name in around:
        put(value, key, values[name])
    for name, axis in axes.items():
        if axis.faults is not None:
            given = [read_fault(words) for words in axis.faults[values[name]]]
            more = [fault.model_dump(mode="json", exclude_unset=True) for fault in given]
            value = merged(value, {"plant": {"faults": [*_faults(value), *more]}})
    for _, key, name in others:
        put(value, key, values[name])
    return value


def _brings_faults(place: tuple[str | int, ...]) -> bool:
    return place == _FAULTS[: len(place)]


def _faults(value: dict[str, Any]) -> list[Any]:
    plant = value.get("plant")
    there = plant.get("faults") if isinstance(plant, dict) else None
    return there if isinstance(there, list) else []


def _fits(place: Any, below: str | int, key: str, done: tuple[str | int, ...]) -> None:
    """Refuse a place that cannot hold the next part of a key."""
    so_far = "".join(f"[{item}]" if isinstance(item, int) else f".{item}" for item in done).removeprefix(".")
    if isinstance(below, str):
        if not isinstance(place, dict):
            raise ConfigurationError(
                f"{key}: {so_far} is a value, allowed: a section that has keys of its own"
            )
    elif not isinstance(place, list) or below >= len(place):
        count = len(place) if isinstance(place, list) else 0
        raise ConfigurationError(
            f"{key}: {so_far} has no entry {below}, it has {count}; give it one in `changes` of the campaign"
        )
