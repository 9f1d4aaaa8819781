"""Which laws are compared: names and settings, the gains from the configuration's own."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, NamedTuple, TypeVar, get_args

import numpy as np
from pydantic import ValidationError

from drivers.arrays import Array
from drivers.config import Section
from drivers.errors import ConfigurationError
from hil.app.compose import pose_arrays
from hil.app.configuration.configuration import Configuration, platform_dict
from hil.app.configuration.controller_file import unusable
from hil.config import ControllerSettings, ModelSettings, Pose, StateSpaceSettings
from hil.control import LAWS
from hil.robot.dynamics import Model
from hil.robot.geometry import Platform
from hil.robot.kinematics import jacobian

Kind = TypeVar("Kind", bound=Section)


class Figures(NamedTuple):
    """What default gains are made of: the loop that the configuration asks for, and the robot."""

    wn: float
    """rad/s."""
    zeta: float
    leg_mass: float
    """kg, the largest eigenvalue of J^-T M J^-1 at home: what six legs feel that move together at worst."""
    mass: float
    """kg, the largest eigenvalue of M at home among translations."""
    inertia: float
    """kg m^2, the same among rotations."""
    force_limit: float
    """N, of a leg."""
    model: ModelSettings
    home: Pose


WN_RAD_S = 20.0
"""Where the configuration's own law has neither wn nor gains in N/m."""
LEG_GAINS = ("kp_N_m", "kv_N_s_m")
POSE_GAINS = ("kp_position_N_m", "kv_position_N_s_m")
GRAVITY_SHARE = 0.1
"""Of gravity: the disturbance that robust laws are made for by default."""
GRAVITY = 9.81
DESIGNED = "hinf"
"""The shipped controller that law `state_space` runs by default, at the rate that it was made for."""

GAINS: dict[str, Callable[[Figures], Any]] = {
    "wn_rad_s": lambda f: f.wn,
    "damping_ratio": lambda f: f.zeta,
    "model": lambda f: f.model,
    # M E'' + K_v E' + K_p E = 0: the heaviest motion gets wn and zeta, the others are faster, better damped.
    "kp_N_m": lambda f: f.leg_mass * f.wn**2,
    "kv_N_s_m": lambda f: 2.0 * f.zeta * f.wn * f.leg_mass,
    "kp_position_N_m": lambda f: f.mass * f.wn**2,
    "kv_position_N_s_m": lambda f: 2.0 * f.zeta * f.wn * f.mass,
    "kp_rotation_N_m_rad": lambda f: f.inertia * f.wn**2,
    "kv_rotation_N_m_s_rad": lambda f: 2.0 * f.zeta * f.wn * f.inertia,
    # A tenth of what K_i may be at most: Routh, K_i m < K_p K_v.
    "ki_N_m_s": lambda f: 0.2 * f.zeta * f.leg_mass * f.wn**3,
    "integral_limit_N": lambda f: f.force_limit,
    # Two poles at zeta wn inside the boundary layer.
    "lambda_rad_s": lambda f: f.zeta * f.wn,
    "reaching_m_s2": lambda _: GRAVITY_SHARE * GRAVITY,
    "uncertainty": lambda _: {"disturbance_m_s2": GRAVITY_SHARE * GRAVITY},
    "controller_file": lambda _: DESIGNED,
}
"""Key of a law's settings -> its value; others are those of the configuration's law, else their default."""
NEEDED: dict[str, Callable[[Figures], Any]] = {
    # The bound on six legs over wn: inside the layer the loop is no faster than it would be without.
    "boundary_layer_m_s": lambda f: 6.0**0.5 * GRAVITY_SHARE * GRAVITY / f.wn,
}
"""The same, for keys that get a value only where they have no default."""


def frozen(variant: str) -> Callable[[Figures], dict[str, Any]]:
    """Return the overrides for a model that is frozen at home."""
    return lambda f: {"model": f.model.model_copy(update={"variant": variant, "frozen_at": f.home})}


def simplified(variant: str) -> Callable[[Figures], dict[str, Any]]:
    """Return the overrides for a model that leaves terms out."""
    return lambda f: {"model": f.model.model_copy(update={"variant": variant, "frozen_at": None})}


VARIANTS: dict[str, tuple[str, Callable[[Figures], dict[str, Any]]]] = {
    "printed": ("inverse_dynamics", simplified("printed")),
    "no_H": ("inverse_dynamics", simplified("no_H")),
    "constant": ("inverse_dynamics", frozen("constant")),
    "constant_MG": ("inverse_dynamics", frozen("constant_MG")),
}
"""Name -> (law, what differs): laws that are another one with another model."""

SETTINGS: dict[str, type[Section]] = {
    get_args(kind.model_fields["law"].annotation)[0]: kind
    for kind in get_args(get_args(ControllerSettings)[0])
}
"""Law -> model of its settings."""


def figures(c: Configuration) -> Figures:
    """Return what the default gains of a configuration are made of."""
    platform = Platform.from_dict(platform_dict(c.platform))
    p, R = pose_arrays(c.platform.home)
    J = jacobian(platform, p, R)
    model: ModelSettings = _fit(getattr(c.controller, "model", None), ModelSettings)
    plain = Model(platform, leg_spin=c.platform.leg_spin, reflected_mass=model.reflected_mass_kg)
    M = plain.mass_matrix(p, R)
    leg_mass = _largest(np.linalg.solve(J.T, np.linalg.solve(J.T, M).T))
    mass = _largest(M[:3, :3])
    on_legs = hasattr(c.controller, "kp_N_m")
    felt, keys = (leg_mass, LEG_GAINS) if on_legs else (mass, POSE_GAINS)
    kp, kv = (np.max(getattr(c.controller, key, 0.0)) for key in keys)
    own = getattr(c.controller, "wn_rad_s", 0.0) or getattr(c.controller, "lambda_rad_s", 0.0)
    wn = float(np.max(own or np.sqrt(kp / felt) or WN_RAD_S))
    zeta = float(getattr(c.controller, "damping_ratio", 0.0) or kv / (2.0 * wn * felt) or 1.0)
    return Figures(
        wn,
        zeta,
        leg_mass=leg_mass,
        mass=mass,
        inertia=_largest(M[3:, 3:]),
        force_limit=c.limits.force_N,
        model=model,
        home=c.platform.home,
    )


def _largest(inertia: Array) -> float:
    return float(np.linalg.eigvalsh((inertia + inertia.T) / 2).max())


def _fit(settings: Section | None, kind: type[Kind]) -> Kind:
    """Return what `settings` have in common with another kind of settings; all defaults of None."""
    given = {} if settings is None else {key: getattr(settings, key) for key in type(settings).model_fields}
    return kind.model_validate({key: value for key, value in given.items() if key in kind.model_fields})


def chosen(c: Configuration, names: Iterable[str] | None = None) -> dict[str, ControllerSettings]:
    """Return the laws to compare, by name: the given ones, else those of section `compare`, else all.

    All are those that have settings: there may be no shipped controller for the loop's rate. The law of
    section `controller` has the settings that it has there. Raises ConfigurationError for a name that is
    none, and for a law whose settings need more than the configuration says.
    """
    own = dict(c.compare.laws)
    known = dict.fromkeys((*own, *LAWS, *VARIANTS))
    unsettled = set() if _unusable(c) is None else {"state_space"}
    wanted = list(names if names is not None else own or [name for name in known if name not in unsettled])
    unknown = [name for name in wanted if name not in known]
    if unknown:
        raise ConfigurationError(f"--laws: no law {', '.join(unknown)}; there are {', '.join(known)}")
    f = figures(c)
    return {name: own[name] if name in own else _default(name, c, f) for name in wanted}


def _unusable(c: Configuration) -> str | None:
    """Say why law `state_space` has no default settings; None where it has some."""
    if c.controller.law == "state_space":
        return None
    designed = StateSpaceSettings(law="state_space", controller_file=DESIGNED)
    return unusable(designed, c.loop.rate_Hz, c.folder)


def _default(name: str, c: Configuration, f: Figures) -> ControllerSettings:
    law, differs = VARIANTS.get(name, (name, lambda _: {}))
    if name == c.controller.law:
        return c.controller
    trouble = _unusable(c) if law == "state_space" else None
    if trouble is not None:
        raise ConfigurationError(f"law {name}: {trouble}; give it in section compare.laws")
    fields = SETTINGS[law].model_fields
    if law == c.controller.law:
        base = {key: getattr(c.controller, key) for key in fields}
    else:
        own = type(c.controller).model_fields.keys() & fields.keys() - {"law"}
        base = {"law": law} | {key: getattr(c.controller, key) for key in own}
        base |= {key: make(f) for key, make in GAINS.items() if key in fields}
        if law == "state_space":
            base["delay_compensation"] = None  # its controller was designed for the delay
        base |= {key: make(f) for key, make in NEEDED.items() if key in fields and fields[key].is_required()}
        if "model" in fields:
            base["model"] = _fit(f.model, _section(fields["model"].annotation))
    try:
        settings: ControllerSettings = SETTINGS[law].model_validate(base | differs(f))  # type: ignore[assignment]
    except ValidationError as error:
        missing = ", ".join(str(item["loc"][0]) if item["loc"] else item["msg"] for item in error.errors())
        raise ConfigurationError(
            f"law {name}: no default settings ({missing}); give it in section compare.laws, or leave it out "
            "with --laws"
        ) from None
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
    scaled = model.model_copy(update={"inertia_scale": model.inertia_scale * scale})
    return settings.model_copy(update={"model": scaled})
