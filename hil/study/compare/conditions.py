"""The paths of a comparison: the configuration, and what it is when its losses are taken out."""

from collections.abc import Mapping
from typing import Any, TypeVar

from pydantic import BaseModel

from hil.app.configuration.configuration import Configuration
from plant_fmu.config import StewartPlant

PATHS = ("ideal", "encoders", "bus", "drives")
"""What is added from one path to the next; the last is the configuration itself."""

Part = TypeVar("Part", bound=BaseModel)
IDEAL: dict[str, Any] = {
    "protocol": "legs", "node_ids": [1, 2, 3, 4, 5, 6], "options": {}, "transmission": None, "homing": None
}  # fmt: skip
"""Of section `drives`, where there is no bus: its drives speak of the legs, not of motors."""


def paths(c: Configuration) -> dict[str, Configuration]:
    """Return the ideal configuration and what it becomes: encoder quanta, then bus time, then drive lag.

    ideal: lengths and rates are exact numbers of the tick, no bus time, the force acts at once. What changes
    nothing is left out: a configuration without bus time has no bus to add. Where law or wrench observer
    know of a delay, they know that it is gone; the hold of half a period stays, on every path. Without a bus
    it is protocol `legs` that carries the numbers: another may have no layout that takes no time.
    """
    without_lag = _no_lag(c)
    on_no_bus = {"bus.layout": "ideal"} | {f"drives.{key}": value for key, value in IDEAL.items()}
    without_bus = changed(_knowing(without_lag, bus_ms=0.0), on_no_bus)
    ideal = changed(without_bus, {"plant.drives.encoder_resolution_m": 0.0})
    found: dict[str, Configuration] = {}
    for name, path in zip(PATHS, (ideal, without_bus, without_lag, c), strict=True):
        if path not in found.values():
            found[name] = path
    return found


def changed(section: Part, changes: Mapping[str, Any]) -> Part:
    """Copy of a section with some keys changed, `plant.drives.encoder_resolution_m`; nothing is validated."""
    for key, value in changes.items():
        head, _, rest = key.partition(".")
        inner = changed(getattr(section, head), {rest: value}) if rest else value
        section = section.model_copy(update={head: inner})
    return section


def _no_lag(c: Configuration) -> Configuration:
    assert c.plant is not None
    places = ["plant.drives", *(["plant.model"] if isinstance(c.plant.model, StewartPlant) else [])]
    return changed(_knowing(c, drive_lag_ms=0.0), {f"{place}.force_bandwidth_Hz": 0.0 for place in places})


def _knowing(c: Configuration, **delays_ms: float) -> Configuration:
    """Return the configuration with other delays for those who reckon with one: law and wrench observer."""
    changes: dict[str, Any] = {f"estimation.wrench.{key}": value for key, value in delays_ms.items()}
    if c.controller.lookahead is not None:
        delay = c.controller.lookahead.model_copy(update=delays_ms)
        some = delay.bus_ms or delay.drive_lag_ms or delay.hold_ms
        changes["controller.delay_compensation"] = delay if some else None
    return changed(c, changes)


def without_limits(c: Configuration) -> Configuration:
    """Return the configuration with the limits of error, force change and speed out of the way.

    The drives' rated force, the ends of the stroke, the consistency of the lengths and the condition of J
    stay: beyond them there is nothing to compare.
    """
    force = c.drives.force_limit_N
    far = dict.fromkeys(("following_error_m", "speed_m_s"), FAR)
    limits = far | {"force_N": force, "force_step_N": 2 * force, "force_window_N": 2 * force}
    return changed(
        c, {f"limits.{key}": value for key, value in limits.items()} | {"limits.deceleration_m_s2": FAR * FAR}
    )


FAR = 1e3
"""m and m/s: no platform gets there."""
