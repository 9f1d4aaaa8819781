"""The paths of a comparison: the configuration, and what it is when its losses are taken out."""

from typing import Any

from hil.app.configuration.configuration import Configuration
from hil.control import ControllerSettings
from plant_fmu.config import StewartPlant

PATHS = ("ideal", "encoders", "bus", "drives")
"""What is added from one path to the next; the last is the configuration itself."""

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
    without_bus = _knowing(without_lag, bus_ms=0.0).model_copy(
        update={
            "bus": c.bus.model_copy(update={"layout": "ideal"}),
            "drives": c.drives.model_copy(update=IDEAL),
        }
    )
    assert without_bus.plant is not None
    exact = without_bus.plant.drives.model_copy(update={"encoder_resolution_m": 0.0})
    ideal = without_bus.model_copy(update={"plant": without_bus.plant.model_copy(update={"drives": exact})})
    found: dict[str, Configuration] = {}
    for name, changed in zip(PATHS, (ideal, without_bus, without_lag, c), strict=True):
        if changed not in found.values():
            found[name] = changed
    return found


def _no_lag(c: Configuration) -> Configuration:
    assert c.plant is not None
    drives = c.plant.drives.model_copy(update={"force_bandwidth_Hz": 0.0})
    changes: dict[str, Any] = {"drives": drives}
    if isinstance(c.plant.model, StewartPlant):
        changes["model"] = c.plant.model.model_copy(update={"force_bandwidth_Hz": 0.0})
    return _knowing(c, drive_lag_ms=0.0).model_copy(update={"plant": c.plant.model_copy(update=changes)})


def _knowing(c: Configuration, **delays_ms: float) -> Configuration:
    """Return the configuration with other delays for those who reckon with one: law and wrench observer."""
    wrench = c.estimation.wrench.model_copy(update=delays_ms)
    changes: dict[str, Any] = {"estimation": c.estimation.model_copy(update={"wrench": wrench})}
    law = c.controller
    if law.lookahead is not None:
        delay = law.lookahead.model_copy(update=delays_ms)
        some = delay.bus_ms or delay.drive_lag_ms or delay.hold_ms
        changes["controller"] = law.model_copy(update={"delay_compensation": delay if some else None})
    return c.model_copy(update=changes)


def with_law(c: Configuration, settings: ControllerSettings) -> Configuration:
    """Return the configuration with another law."""
    return c.model_copy(update={"controller": settings})


def without_limits(c: Configuration) -> Configuration:
    """Return the configuration with the limits of error, force change and speed out of the way.

    The drives' rated force, the ends of the stroke, the consistency of the lengths and the condition of J
    stay: beyond them there is nothing to compare.
    """
    force = c.drives.force_limit_N
    limits = c.limits.model_copy(
        update={
            "force_N": force,
            "force_step_N": 2 * force,
            "force_window_N": 2 * force,
            "following_error_m": FAR,
            "speed_m_s": FAR,
            "deceleration_m_s2": FAR * FAR,
        }
    )
    return c.model_copy(update={"limits": limits})


FAR = 1e3
"""m and m/s: no platform gets there."""
