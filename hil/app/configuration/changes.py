"""Changes values of a configuration and writes its complete text, which a log stores."""

from collections.abc import Iterator, Mapping
from pathlib import PurePath
from typing import Any

import numpy as np
import yaml
from pydantic import BaseModel

from drivers.errors import ConfigurationError
from hil.app.configuration.configuration import Configuration
from hil.app.configuration.yaml_positions import parse

KINDS = ("law", "type")
"""Keys that decide which other keys a section has."""


class _Dumper(yaml.SafeDumper):
    """YAML writer that quotes text which YAML 1.2 could read otherwise, and writes no aliases."""

    def ignore_aliases(self, data: object) -> bool:
        del data
        return True


def _text(dumper: _Dumper, text: str) -> yaml.ScalarNode:
    return dumper.represent_scalar("tag:yaml.org,2002:str", text, style=None if text.isidentifier() else '"')


_Dumper.add_representer(str, _text)


def with_changes(text: str, changes: Mapping[str, Any]) -> str:
    """Text of a configuration with changes: section -> value, or a mapping of the keys to change.

    A mapping is merged into the section, key by key. A mapping with another `law` or `type` replaces the
    section, since the other keys belonged to the old one. None removes a key: its default holds.

    Raises ConfigurationError: a value that YAML cannot hold.
    """
    return text_of(merged(parse(text).value or {}, changes))


def text_of(value: Any) -> str:
    """YAML text of plain data; reading the text gives the same data."""
    return yaml.dump(value, Dumper=_Dumper, sort_keys=False, allow_unicode=True)


def merged(value: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Data of a configuration with changes applied, as in `with_changes`. Raises as `with_changes`."""
    found: dict[str, Any] = _merged(value, {key: _plain(change, key) for key, change in changes.items()})
    return found


def _merged(there: Any, change: Any) -> Any:
    if not isinstance(change, dict):
        return change
    other = isinstance(there, dict) and any(k in change and change[k] != there.get(k) for k in KINDS)
    found = dict(there) if isinstance(there, dict) and not other else {}
    for key, value in change.items():
        if value is None:
            found.pop(key, None)
        else:
            found[key] = _merged(found.get(key), value)
    return found


def _plain(value: Any, place: str) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _plain(inner, f"{place}.{key}") for key, inner in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, list | tuple):
        return [_plain(inner, f"{place}[{k}]") for k, inner in enumerate(value)]
    if isinstance(value, PurePath):
        return str(value)
    if value is None or isinstance(value, bool | int | float | str):
        return value
    raise ConfigurationError(
        f"{place}: {value!r} is not allowed in a configuration; allowed: numbers, text, true and false, "
        "lists, mappings"
    )


Keys = Mapping[str, tuple[str, ...]]
OPERATOR: Keys = {"operator": ("start", "deadman_s", "stays")}
"""Keys that make a run wait for an operator; without an operator it would wait for ever, without a fault."""
UNATTENDED: Keys = {**OPERATOR, "plant": ("homing_file",)}
"""These keys, and the file that lets one run begin where another has parked."""


def unattended(c: Configuration) -> Configuration:
    """Configuration for a simulation without an operator: keys that wait for one have their defaults."""
    return _without(c, UNATTENDED)


def without_operator(c: Configuration) -> Configuration:
    """Configuration for a run without operator commands; its homing file stays."""
    return _without(c, OPERATOR)


def unattended_data(value: Mapping[str, Any], taken: Keys = UNATTENDED) -> dict[str, Any]:
    """Data of a configuration without the keys in `taken`, which wait for an operator."""
    there = {name: keys for name, keys in taken.items() if isinstance(value.get(name), dict)}
    return merged(value, {name: dict.fromkeys(keys) for name, keys in there.items()})


def _without(c: Configuration, taken: Keys) -> Configuration:
    changes = {}
    for name, keys in taken.items():
        if section := getattr(c, name):
            fields = type(section).model_fields
            changes[name] = section.model_copy(update={key: fields[key].get_default() for key in keys})
    if all(getattr(c, name) == section for name, section in changes.items()):
        return c
    found = c.model_copy(update=changes)
    found._text = text_of(unattended_data(parse(c.text).value or {}, taken))  # noqa: SLF001
    return found


def differences(one: Configuration, other: Configuration) -> Iterator[tuple[str, Any, Any]]:
    """Yield the keys in which two configurations differ, with both values; None: no such key."""
    here, there = (dict(_flat("", dict(c))) for c in (one, other))
    for key in here | there:
        if here.get(key) != there.get(key):
            yield key, here.get(key), there.get(key)


def _flat(key: str, value: Any) -> Iterator[tuple[str, Any]]:
    """Yield the values of nested sections with dotted keys."""
    found = value.model_dump(mode="json") if isinstance(value, BaseModel) else value
    if not isinstance(found, dict):
        yield key, found
        return
    for name, inner in found.items():
        yield from _flat(f"{key}.{name}".removeprefix("."), inner)
