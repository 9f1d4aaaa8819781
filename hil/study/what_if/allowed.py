"""What a configuration has to share with a log so that the recorded inputs mean the same to it.

The controller may be another one in all it decides. What the drives and sensors were, what was set in them,
and how their frames are read, was decided when the log was made.
"""

from typing import Any

from pydantic import BaseModel

from drivers.errors import ConfigurationError
from hil.app.configuration.configuration import Configuration

FREE_OF_DRIVES: dict[str, Any] = {"brake_after_ms": True, "homing": {"file"}}
"""Keys of `drives` that neither a frame nor the controller has: where the legs stood is in the log."""
UNNAMED = {"name", "description", "compare", "watch"}
"""Sections whose changes are not named: no controller has them."""


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
    for kind in type(c.sensors).model_fields:
        sensor = getattr(c.sensors, kind)
        for key in ("node_id", "channel") if sensor is not None else ():
            value = getattr(sensor, key)
            found[f"sensors.{kind}.{key}"] = (
                value,
                "its frames are known by it; none: the log has no frame of one",
            )
    return found


def changes(there: Configuration, here: Configuration) -> list[str]:
    """Return which keys of two configurations differ, each with both values."""
    names = [name for name in Configuration.model_fields if name not in UNNAMED]
    one, other = ({name: _plain(getattr(c, name)) for name in names} for c in (there, here))
    return _changed("", one, other)


def _plain(section: Any) -> Any:
    return section.model_dump(mode="json") if isinstance(section, BaseModel) else section


def _changed(key: str, there: Any, here: Any) -> list[str]:
    if there == here:
        return []
    if not (isinstance(there, dict) and isinstance(here, dict)):
        return [f"{key}: {_text(there)} -> {_text(here)}"]
    names = dict.fromkeys((*there, *here))
    return [
        line
        for name in names
        for line in _changed(f"{key}.{name}".removeprefix("."), there.get(name), here.get(name))
    ]


def _text(value: Any) -> str:
    """Return a value in short."""
    text = "none" if value is None else str(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
