"""A configuration whose run nobody attends: it starts, ends and begins where its plant does, by itself."""

from collections.abc import Mapping
from typing import Any

from hil.app.configuration.changes import merged, text_of
from hil.app.configuration.configuration import Configuration
from hil.app.configuration.yaml_positions import parse

Keys = Mapping[str, tuple[str, ...]]
OPERATOR: Keys = {"operator": ("start", "deadman_s", "stays")}
"""By which a run waits for somebody: where nobody is, the platform stands, and fails no limit, for ever."""
UNATTENDED: Keys = {**OPERATOR, "plant": ("homing_file",)}
"""These, and the file by which one run begins where another has parked."""


def unattended(c: Configuration) -> Configuration:
    """Return the configuration as a command runs it in simulated time that lets no operator speak."""
    return _without(c, UNATTENDED)


def without_operator(c: Configuration) -> Configuration:
    """Return the configuration as it runs where nobody gives commands; it keeps its homing file."""
    return _without(c, OPERATOR)


def unattended_data(value: Mapping[str, Any], taken: Keys = UNATTENDED) -> dict[str, Any]:
    """Return the data of a configuration without the keys that are taken from it."""
    there = {
        section: dict.fromkeys(keys)
        for section, keys in taken.items()
        if isinstance(value.get(section), dict)
    }
    return merged(value, there)


def _without(c: Configuration, taken: Keys) -> Configuration:
    changes = {}
    for name, keys in taken.items():
        section = getattr(c, name)
        if section is not None:
            fields = type(section).model_fields
            own = section.model_copy(update={key: fields[key].get_default() for key in keys})
            if own != section:
                changes[name] = own
    if not changes:
        return c
    found = c.model_copy(update=changes)
    found._text = text_of(unattended_data(parse(c.text).value or {}, taken))  # noqa: SLF001
    return found
