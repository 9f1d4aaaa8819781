"""Which laws are compared: names and settings, the gains from the configuration's own."""

from collections.abc import Iterable
from typing import Any, TypeVar, get_args

import numpy as np
from pydantic import ValidationError

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
from hil.study.compare.conditions import changed

Kind = TypeVar("Kind", bound=Section)
WN_RAD_S = 20.0
"""Where the configuration's own law says nothing of a frequency."""


VARIANTS = ("printed", "no_H", "constant", "constant_MG")
"""Variants of the model with which inverse dynamics is compared, too, under their names."""


def desired_loop(c: Configuration) -> DesiredLoop:
    """Return what the default gains of a configuration are made of."""
    platform = build_platform(c.platform)
    p, R = pose_arrays(c.platform.home)
    J = jacobian(platform, p, R)
    reflected = _model(c).reflected_mass_kg
    M = Model(platform, leg_spin=c.platform.leg_spin, reflected_mass=reflected).mass_matrix(p, R)
    leg_mass = _largest(np.linalg.solve(J.T, np.linalg.solve(J.T, M).T))
    mass = _largest(M[:3, :3])
    wn, zeta = c.controller.bandwidth(leg_mass, mass) or (WN_RAD_S, 1.0)
    return DesiredLoop(wn, zeta, leg_mass, mass, _largest(M[3:, 3:]), c.limits.force_N)


def _largest(inertia: Array) -> float:
    return float(np.linalg.eigvalsh((inertia + inertia.T) / 2).max())


def _fit(settings: Section | None, kind: type[Kind]) -> Kind:
    """Return what `settings` have in common with another kind of settings; all defaults of None."""
    given = {} if settings is None else {key: getattr(settings, key) for key in type(settings).model_fields}
    return kind.model_validate({key: value for key, value in given.items() if key in kind.model_fields})


def _model(c: Configuration) -> ModelSettings:
    return _fit(getattr(c.controller, "model", None), ModelSettings)


def chosen(c: Configuration, names: Iterable[str] | None = None) -> dict[str, ControllerSettings]:
    """Return the laws to compare, by name: the given ones, else those of section `compare`, else all.

    All are those that have settings: there may be no shipped controller for the loop's rate. The law of
    section `controller` has the settings that it has there. Raises ConfigurationError for a name that is
    none, and for a law whose settings need more than the configuration says.
    """
    own = c.compare.laws
    known = list(dict.fromkeys((*own, *LAWS, *VARIANTS, c.controller.law)))
    wanted = list(own) if names is None else list(names)
    every = names is None and not own
    unknown = [name for name in wanted if name not in known]
    if unknown:
        raise ConfigurationError(f"--laws: no law {', '.join(unknown)}; there are {', '.join(known)}")
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
    """Return a law's settings. Raises ConfigurationError where the configuration does not give them all."""
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
    """Return the settings among what a field may be: of `ModelSettings | None` the former."""
    return next(
        k for k in (annotation, *get_args(annotation)) if isinstance(k, type) and issubclass(k, Section)
    )


def with_scale(settings: ControllerSettings, scale: float) -> ControllerSettings:
    """Return the settings of a law that believes in masses `scale` times its own; PD believes in none."""
    model = getattr(settings, "model", None)
    if model is None or scale == 1.0:
        return settings
    return changed(settings, {"model.inertia_scale": model.inertia_scale * scale})
