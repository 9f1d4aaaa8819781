"""The configuration of a what-if: its changes, and what it has to share with the log.

The controller may be another one in all it decides. What the drives and sensors were, what was set in them,
and how their frames are read, was decided when the log was made.
"""

import re
from collections.abc import Iterator, Sequence
from typing import Any

from pydantic import BaseModel

from drivers.errors import ConfigurationError
from hil.app.configuration.changes import with_changes
from hil.app.configuration.configuration import Configuration, loads
from hil.app.configuration.yaml_positions import parse
from hil.study.campaign.keys import put

FREE_OF_DRIVES: dict[str, Any] = {"brake_after_ms": True, "homing": {"file"}}
"""Keys of `drives` that neither a frame nor the controller has: where the legs stood is in the log."""
UNNAMED = {"name", "description", "compare", "watch"}
"""Sections whose changes are not named: no controller has them."""


def read_changes(words: Sequence[str]) -> dict[str, Any]:
    """Return changes as `hil.app.configuration.changes` takes them, of words as `controller.wn_rad_s=25`.

    A value is YAML; an empty one takes a key or a section away, and its default holds.

    Raises ConfigurationError: words of another form, or a key in one that is set to a value.
    """
    found: dict[str, Any] = {}
    for each in words:
        key, equals, text = each.partition("=")
        document = parse(f"value: {text}")
        if not equals or document.problems or document.value is None or set(document.value) != {"value"}:
            raise ConfigurationError(
                f"--set {each}: allowed: section.key=value with a YAML value, as controller.wn_rad_s=25; a "
                "list or a section is given as a whole, as 'monitor={action: warn}'"
            )
        try:
            put(found, key, document.value["value"])
        except ConfigurationError as error:
            raise ConfigurationError(f"--set {error}") from None
    return found


def changed(c: Configuration, words: Sequence[str], *, own: bool) -> Configuration:
    """Return a configuration with changes.

    own : it is the configuration in a log, whose folder nobody looks into.

    Raises ConfigurationError as `read_changes`; and for what the changed configuration has wrong.
    """
    if not words:
        return c
    name = f"{c.source} with --set"
    text = with_changes(c.text, {"name": c.name} | read_changes(words))
    try:
        return loads(text, name, None if own else c.folder)
    except ConfigurationError as error:  # nobody has the text in which it is wrong
        problems = (re.sub(r"^.*?:\d+:\d+: ", f"{name}: ", problem) for problem in error.problems)
        raise ConfigurationError(*problems) from None


def refuse_other_inputs(there: Configuration, here: Configuration, rate_Hz: float) -> None:
    """Refuse a configuration to which the inputs of a log would not mean what they meant.

    there : of the log; here : the one that is asked about; rate_Hz : at which the log's run went.

    Raises ConfigurationError with all that differs.
    """
    recorded = _inputs(there)
    if here.loop.rate_Hz == rate_Hz:
        recorded["loop.rate_Hz"] = rate_Hz, ""
    found = []
    for key, (given, why) in _inputs(here).items():
        needed = recorded.get(key, (None, ""))[0]
        if given != needed:
            found.append(
                f"{here.source}: {key}: {_text(given)}, allowed: {_text(needed)}, as in the log: {why}"
            )
    if found:
        raise ConfigurationError(
            *found,
            "Give these keys the values of the log, or change keys of the log's own configuration, with "
            "--set KEY=VALUE and no --what-if",
        )


def _inputs(c: Configuration) -> dict[str, tuple[Any, str]]:
    """Return by what recorded inputs are understood: key -> value, and why it has to be that of the log."""
    laid, read = "the frames are laid out so", "the drives were so, and their frames are read by it"
    found: dict[str, tuple[Any, str]] = {
        "bus.layout": (c.bus.layout, laid),
        "bus.channels (legs of each bus)": (c.bus.legs, laid),
        "reactions.silence": (c.reactions.silence, "it was set in the drives, which confirm it"),
        "loop.rate_Hz": (c.loop.rate_Hz, "its ticks are so far apart"),
    }
    for key, value in c.drives.model_dump(mode="json", exclude=FREE_OF_DRIVES).items():
        own = "; the controller's own limit is limits.force_N" if key == "force_limit_N" else ""
        found[f"drives.{key}"] = value, read + own
    why = "its frames are known by it; none: the log has no frame of one"
    for kind, sensor in c.sensors:
        if sensor is not None:
            found |= {f"sensors.{kind}.{key}": (getattr(sensor, key), why) for key in ("node_id", "channel")}
    return found


def changes(there: Configuration, here: Configuration) -> list[str]:
    """Return which keys of two configurations differ, each with both values."""
    one, other = (dict(_flat("", dict(c))) for c in (there, here))
    keys = [key for key in {**one, **other} if key.partition(".")[0] not in UNNAMED]
    return [
        f"{key}: {_text(one.get(key))} -> {_text(other.get(key))}"
        for key in keys
        if one.get(key) != other.get(key)
    ]


def _flat(key: str, value: Any) -> Iterator[tuple[str, Any]]:
    """Yield the keys of sections within sections with dots, each with its value."""
    found = value.model_dump(mode="json") if isinstance(value, BaseModel) else value
    if not isinstance(found, dict):
        yield key, found
        return
    for name, inner in found.items():
        yield from _flat(f"{key}.{name}".removeprefix("."), inner)


def _text(value: Any) -> str:
    """Return a value in short."""
    text = "none" if value is None else str(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
