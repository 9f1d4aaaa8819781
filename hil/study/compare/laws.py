"""Laws to compare, with gains derived from the configured law, and configurations with losses removed."""

from collections.abc import Iterable, Mapping
from typing import Any, TypeVar, get_args

import numpy as np
from pydantic import BaseModel, ValidationError

from drivers.arrays import Array
from drivers.errors import ConfigurationError
from drivers.section import Section
from hil.app.configuration.configuration import Configuration
from hil.app.configuration.controller_file import unusable
from hil.app.configuration.platform import build_platform, pose_arrays
from hil.config.model import ModelSettings
from hil.control import LAWS, ControllerSettings
from hil.control.law import DesiredLoop
from hil.robot.dynamics import Model
from hil.robot.kinematics import jacobian
from plant_fmu.config import StewartPlant

Kind = TypeVar("Kind", bound=Section)
Part = TypeVar("Part", bound=BaseModel)
WN_RAD_S = 20.0
"""Bandwidth if the configuration's own law specifies none."""
VARIANTS = ("printed", "no_H", "constant", "constant_MG")
"""Variants of the model that are compared in inverse dynamics, each under its own name."""
PATHS = ("ideal", "encoders", "bus", "drives")
"""Each path adds the losses in its name to the path before it; the last is the configuration itself."""
IDEAL: dict[str, Any] = {
    "protocol": "legs", "node_ids": [1, 2, 3, 4, 5, 6], "options": {}, "transmission": None, "homing": None
}  # fmt: skip
"""Section `drives` of a path without a bus: its drives report leg lengths, not motor positions."""


def desired_loop(c: Configuration) -> DesiredLoop:
    """Closed loop at home, with bandwidth and inertias, from which default gains are derived."""
    platform = build_platform(c.platform)
    p, R = pose_arrays(c.platform.home)
    J = jacobian(platform, p, R)
    known: Any = _model(c)  # of a law without a model the robot has the rotors of the plant
    if c.controller.believed is None and c.plant is not None and isinstance(c.plant.model, StewartPlant):
        known = c.plant.model
    reflected = known.reflected_mass_kg
    M = Model(platform, leg_spin=c.platform.leg_spin, reflected_mass=reflected).mass_matrix(p, R)
    leg_mass = _largest(np.linalg.solve(J.T, np.linalg.solve(J.T, M).T))
    mass = _largest(M[:3, :3])
    wn, zeta = c.controller.bandwidth(leg_mass, mass) or (WN_RAD_S, 1.0)
    return DesiredLoop(wn, zeta, leg_mass, mass, _largest(M[3:, 3:]), c.limits.force_N)


def _largest(inertia: Array) -> float:
    return float(np.linalg.eigvalsh((inertia + inertia.T) / 2).max())


def _fit(settings: Section | None, kind: type[Kind]) -> Kind:
    """Settings of class `kind`, filled with the keys that `settings` shares; None: all defaults."""
    given = {} if settings is None else {key: getattr(settings, key) for key in type(settings).model_fields}
    return kind.model_validate({key: value for key, value in given.items() if key in kind.model_fields})


def _model(c: Configuration) -> ModelSettings:
    return _fit(getattr(c.controller, "model", None), ModelSettings)


def chosen(c: Configuration, names: Iterable[str] | None = None) -> dict[str, ControllerSettings]:
    """Laws to compare, by name: the given names, else section `compare`, else all.

    "All" leaves out laws without default settings: there may be no shipped controller for the loop's rate.
    The law of section `controller` keeps its settings there. Raises ConfigurationError: unknown name, or a
    law whose settings need more than the configuration gives.
    """
    own = c.compare.laws
    known = list(dict.fromkeys((*own, *LAWS, *VARIANTS, c.controller.law)))
    wanted = list(own) if names is None else list(names)
    every = names is None and not own
    unknown = [name for name in wanted if name not in known]
    if unknown:
        raise ConfigurationError(f"--laws: unknown law {', '.join(unknown)}; allowed: {', '.join(known)}")
    loop = desired_loop(c)
    found: dict[str, ControllerSettings] = {}
    for name in known if every else wanted:
        try:
            found[name] = own[name] if name in own else _default(name, c, loop)
        except ConfigurationError:
            if not every:
                raise
    return found


def _default(name: str, c: Configuration, loop: DesiredLoop) -> ControllerSettings:
    """Default settings of a law. Raises ConfigurationError if the configuration leaves a setting open."""
    if name == c.controller.law:
        return c.controller
    law = "inverse_dynamics" if name in VARIANTS else name
    kind = LAWS[law]
    fields = kind.model_fields
    common = type(c.controller).model_fields.keys() & fields.keys() - {"law"}
    given: dict[str, Any] = {"law": law} | {key: getattr(c.controller, key) for key in common}
    if law != c.controller.law:
        given |= kind.derived(loop)
        if "model" in fields:
            given["model"] = _fit(_model(c), _section(fields["model"].annotation))
    if name in VARIANTS:
        pose = c.platform.home if name.startswith("constant") else None
        given["model"] = _model(c).model_copy(update={"variant": name, "frozen_at": pose})
    try:
        settings: ControllerSettings = kind.model_validate(given)
    except ValidationError as error:
        missing = ", ".join(str(item["loc"][0]) if item["loc"] else item["msg"] for item in error.errors())
        raise ConfigurationError(
            f"law {name}: no default settings ({missing}); give it in section compare.laws, or leave it out "
            "with --laws"
        ) from None
    trouble = unusable(settings, c.loop.rate_Hz, c.folder)
    if trouble is not None:
        raise ConfigurationError(f"law {name}: {trouble}; give it in section compare.laws")
    return settings


def _section(annotation: Any) -> type[Section]:
    """Find the settings class in the type of a field: `ModelSettings` of `ModelSettings | None`."""
    return next(
        k for k in (annotation, *get_args(annotation)) if isinstance(k, type) and issubclass(k, Section)
    )


def with_scale(settings: ControllerSettings, scale: float) -> ControllerSettings:
    """Settings of a law with its model's masses scaled; a law without a model, e.g. PD, stays unchanged."""
    model = getattr(settings, "model", None)
    if model is None or scale == 1.0:
        return settings
    return changed(settings, {"model.inertia_scale": model.inertia_scale * scale})


def paths(c: Configuration) -> dict[str, Configuration]:
    """Configurations with signal losses removed: ideal, then encoder resolution, bus time, drive lag added.

    ideal: lengths and rates are exact numbers of the tick, no bus time, the force acts at once. A step that
    changes nothing is left out: a configuration without bus time has no bus to add. Delay compensation and
    wrench observer know the delays of each path; the hold of half a period stays on all paths. Without a bus,
    protocol `legs` carries the numbers, because another may have no layout without bus time.
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
    """Copy of a section with some keys changed, e.g. `plant.drives.encoder_resolution_m`; not validated."""
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
    """Configuration whose delay compensation and wrench observer assume other delays, ms."""
    changes: dict[str, Any] = {f"estimation.wrench.{key}": value for key, value in delays_ms.items()}
    if c.controller.lookahead is not None:
        delay = c.controller.lookahead.model_copy(update=delays_ms)
        some = delay.bus_ms or delay.drive_lag_ms or delay.hold_ms
        changes["controller.delay_compensation"] = delay if some else None
    return changed(c, changes)


def without_limits(c: Configuration) -> Configuration:
    """Configuration without the limits of tracking error, force change and speed.

    The drives' rated force, the ends of the stroke, the consistency of the lengths and the condition of J
    remain limited: beyond them a comparison has no meaning.
    """
    force = c.drives.force_limit_N
    limits = {"force_N": force, "force_step_N": 2 * force, "force_window_N": 2 * force}
    limits |= {"following_error_m": 1e3, "speed_m_s": 1e3, "deceleration_m_s2": 1e6}  # no platform gets there
    return changed(c, {f"limits.{key}": value for key, value in limits.items()})
