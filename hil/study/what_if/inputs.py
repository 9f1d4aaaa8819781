"""Configuration of `--what-if`: its changes, and the keys that must agree with the log.

The controller may differ in all its decisions. Drives, sensors, their settings and the coding of their frames
were fixed when the log was recorded.
"""

import re
from collections.abc import Sequence
from typing import Any

from drivers.errors import ConfigurationError
from hil.app.configuration.changes import differences, with_changes
from hil.app.configuration.configuration import Configuration, loads
from hil.app.configuration.yaml_positions import parse
from hil.study.campaign.keys import put

FREE_OF_DRIVES: dict[str, Any] = {"brake_after_ms": True, "homing": {"file"}}
"""Keys of `drives` that affect neither frames nor controller; the log has the initial leg positions."""
UNNAMED = {"name", "description", "compare", "watch"}
"""Sections whose changes are not listed: they do not affect a controller."""


def read_changes(words: Sequence[str]) -> dict[str, Any]:
    """Parse changes of a configuration such as `controller.wn_rad_s=25` into nested data.

    A value is YAML; an empty value removes a key or a section, so that its default holds.

    Raises ConfigurationError: malformed words, or a key inside a key that has a plain value.
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
    """Configuration with changes such as `controller.wn_rad_s=25` applied.

    own : it is the configuration in a log; no folder is searched for its files.

    Raises ConfigurationError: as `read_changes`, or the changed configuration is invalid.
    """
    if not words:
        return c
    name = f"{c.source} with --set"
    text = with_changes(c.text, {"name": c.name} | read_changes(words))
    try:
        return loads(text, name, None if own else c.folder, c.files)
    except ConfigurationError as error:  # positions in a text that no user has seen
        problems = (re.sub(r"^.*?:\d+:\d+: ", f"{name}: ", problem) for problem in error.problems)
        raise ConfigurationError(*problems) from None


def refuse_other_inputs(there: Configuration, here: Configuration, rate_Hz: float) -> None:
    """Refuse a configuration under which the recorded inputs of a log would have another meaning.

    there : configuration in the log; here : other configuration; rate_Hz : rate of the log's run.

    Raises ConfigurationError with all differences.
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
            "Give these keys the values of the log, or change the log's own configuration: --set KEY=VALUE "
            "without --what-if",
        )


def _inputs(c: Configuration) -> dict[str, tuple[Any, str]]:
    """{key: (value, reason)}: keys that must agree with the log, since they code the recorded inputs."""
    laid, read = "the layout of its frames", "it determines drives and the coding of their frames"
    found: dict[str, tuple[Any, str]] = {
        "bus.layout": (c.bus.layout, laid),
        "bus.channels (legs of each bus)": (c.bus.legs, laid),
        "reactions.silence": (c.reactions.silence, "the drives were set to it and confirm it"),
        "loop.rate_Hz": (c.loop.rate_Hz, "the period of its ticks"),
    }
    for key, value in c.drives.model_dump(mode="json", exclude=FREE_OF_DRIVES).items():
        own = "; the controller's own limit is limits.force_N" if key == "force_limit_N" else ""
        found[f"drives.{key}"] = value, read + own
    why = "it identifies the sensor's frames; none: the log has no such frames"
    for kind, sensor in c.sensors:
        if sensor is not None:
            keys = [key for key in ("node_id", "node_ids", "channel") if hasattr(sensor, key)]
            found |= {f"sensors.{kind}.{key}": (getattr(sensor, key), why) for key in keys}
            found[f"sensors.{kind}.device"] = (sensor.device.model_dump(exclude={"file"}), why)
    return found


def changes(there: Configuration, here: Configuration) -> list[str]:
    """Keys in which two configurations differ, each with both values, as texts."""
    return [
        f"{key}: {_text(one)} -> {_text(other)}"
        for key, one, other in differences(there, here)
        if key.partition(".")[0] not in UNNAMED
    ]


def _text(value: Any) -> str:
    """Short text of a value."""
    text = "none" if value is None else str(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
