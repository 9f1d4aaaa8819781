"""What a configuration has to share with a log so that the recorded inputs mean the same to it.

The controller may be another one in all it decides. What the drives and sensors were, what was set in them,
and how their frames are read, was decided when the log was made.
"""

from collections.abc import Iterator
from typing import Any

from pydantic import BaseModel

from drivers.errors import ConfigurationError
from hil.app.configuration.configuration import Configuration

FREE_OF_DRIVES = {"brake_after_ms"}
"""Keys of `drives` that neither a frame nor the controller has."""
FREE_OF_HOMING = {"file"}
"""Where the legs stood is in the log."""
UNNAMED = {"name", "description", "compare", "watch"}
"""Sections whose changes are not named: no controller has them."""


def refuse_other_inputs(there: Configuration, here: Configuration, rate_Hz: float) -> None:
    """Refuse a configuration to which the inputs of a log would not mean what they meant.

    there : of the log; here : the one that is asked about; rate_Hz : at which the log's run went.

    Raises ConfigurationError with all that differs.
    """
    found = [
        f"{here.source}: {key}: {_text(given)}, allowed: {_text(recorded)}, as in the log: {why}"
        for key, recorded, given, why in (
            *_bus(there, here),
            *_drives(there, here),
            *_sensors(there, here),
            *_rate(there, here, rate_Hz),
        )
    ]
    if found:
        raise ConfigurationError(
            *found,
            "Give these keys the values of the log, or change keys of the log's own configuration, with "
            "--set KEY=VALUE and no --what-if",
        )


def changes(there: Configuration, here: Configuration) -> list[str]:
    """Return which keys of two configurations differ, each with both values."""
    found: list[str] = []
    for section in Configuration.model_fields:
        if section in UNNAMED:
            continue
        pair = (_plain(getattr(each, section)) for each in (there, here))
        found += _changed(section, *pair)
    return found


_Different = tuple[str, Any, Any, str]


def _bus(there: Configuration, here: Configuration) -> Iterator[_Different]:
    for key, recorded, given in (
        ("bus.layout", there.bus.layout, here.bus.layout),
        ("bus.channels (legs of each bus)", there.bus.legs, here.bus.legs),
    ):
        if recorded != given:
            yield key, recorded, given, "the frames are laid out so"


def _drives(there: Configuration, here: Configuration) -> Iterator[_Different]:
    recorded, given = (_plain(each.drives) for each in (there, here))
    for key in recorded:
        if key in FREE_OF_DRIVES:
            continue
        a, b = (
            {k: v for k, v in value.items() if k not in FREE_OF_HOMING} if isinstance(value, dict) else value
            for value in (recorded[key], given[key])
        )
        if a != b:
            why = "the drives were so, and their frames are read by it"
            if key == "force_limit_N":
                why += "; the controller's own limit is limits.force_N"
            yield f"drives.{key}", a, b, why
    silence = there.reactions.silence, here.reactions.silence
    if silence[0] != silence[1]:
        yield "reactions.silence", *silence, "it was set in the drives, which confirm it"


def _sensors(there: Configuration, here: Configuration) -> Iterator[_Different]:
    for kind in type(there.sensors).model_fields:
        recorded, given = getattr(there.sensors, kind), getattr(here.sensors, kind)
        if given is None:
            continue
        if recorded is None:
            yield f"sensors.{kind}", None, _plain(given), "the log has no frame of one"
            continue
        for key in ("node_id", "channel"):
            a, b = getattr(recorded, key), getattr(given, key)
            if a != b:
                yield f"sensors.{kind}.{key}", a, b, "its frames are known by it"


def _rate(there: Configuration, here: Configuration, rate_Hz: float) -> Iterator[_Different]:
    given = here.loop.rate_Hz
    if given not in (there.loop.rate_Hz, rate_Hz):
        yield "loop.rate_Hz", there.loop.rate_Hz, given, f"its ticks are {1e3 / rate_Hz:g} ms apart"


def _plain(section: Any) -> Any:
    return section.model_dump(mode="json") if isinstance(section, BaseModel) else section


def _changed(key: str, there: Any, here: Any) -> list[str]:
    if there == here:
        return []
    if not (isinstance(there, dict) and isinstance(here, dict)):
        return [f"{key}: {_text(there)} -> {_text(here)}"]
    names = dict.fromkeys((*there, *here))
    return [line for name in names for line in _changed(f"{key}.{name}", there.get(name), here.get(name))]


def _text(value: Any) -> str:
    """Return a value in short."""
    text = "none" if value is None else str(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
