"""Opens the configured plant: our Stewart FMU, any other FMU, or the bench.

`FmuHost` runs an FMU in this process, `ChildHost` in one of its own.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from drivers.arrays import Array
from drivers.errors import PlantError
from plant_fmu.bench import Bench
from plant_fmu.config import BenchPlant, FmuPlant, PlantSettings, StewartPlant
from plant_fmu.fmu.child import ChildHost
from plant_fmu.fmu.host import FmuHost
from plant_fmu.fmu.spec import FmuSpec, Parameter, TruthNames, spec_from_settings
from plant_fmu.plant import Plant
from plant_fmu.stewart.build import build

__all__ = ["Bench", "ChildHost", "FmuHost", "host", "open_plant", "stewart_parameters", "stewart_plant"]


def host(spec: FmuSpec, isolation: str) -> Plant:
    """Load an FMU `in_process` or in a `child_process`. Raises PlantError."""
    return FmuHost(spec) if isolation == "in_process" else ChildHost(spec)


def _floats(value: Any, shape: tuple[int, ...], name: str) -> list[float]:
    try:
        array = np.asarray(value, np.float64)
    except (TypeError, ValueError) as error:
        raise PlantError(f"platform: {name}: {value!r} is not numeric") from error
    if array.shape != shape:
        raise PlantError(f"platform: {name} has shape {array.shape}; {shape} is needed")
    return [float(x) for x in array.ravel()]


def stewart_parameters(
    settings: StewartPlant,
    platform: Mapping[str, Any],
    length_min: Array,
    length_max: Array,
    p0: Array,
    R0: Array,
    twist0: Array | None = None,
) -> dict[str, Parameter]:
    """Return our FMU's parameters for one robot.

    platform: base_joints (6, 3) m, platform_joints (6, 3) m, platform {mass, com, inertia}, cylinder and rod
    {mass, com, inertia_axial, inertia_transverse}, gravity (3,), optional leg_spin and
    universal_joint_base_axes (6, 3); SI. length_min, length_max (6,) m; p0 (3,) m, R0 (3, 3), twist0 (6,).
    Raises PlantError on a missing key or a wrong shape.
    """
    try:
        body = platform["platform"]
        parameters: dict[str, Parameter] = {
            "base_joints": _floats(platform["base_joints"], (6, 3), "base_joints"),
            "platform_joints": _floats(platform["platform_joints"], (6, 3), "platform_joints"),
            "mass": float(body["mass"]),
            "com": _floats(body["com"], (3,), "platform.com"),
            "inertia": _floats(body["inertia"], (3, 3), "platform.inertia"),
            "gravity": _floats(platform["gravity"], (3,), "gravity"),
        }
        for half in ("cylinder", "rod"):
            part = platform[half]
            axial = part.get("inertia_axial") or 0.0
            parameters[f"{half}_mass"] = float(part["mass"])
            parameters[f"{half}_com"] = float(part["com"])
            parameters[f"{half}_inertia"] = [float(axial), float(part["inertia_transverse"])]
    except KeyError as error:
        raise PlantError(f"platform: {error.args[0]} is missing") from error
    parameters["leg_spin"] = str(platform.get("leg_spin") or "none")
    axes = platform.get("universal_joint_base_axes")
    if axes is not None:
        parameters["universal_joint_base_axes"] = _floats(axes, (6, 3), "universal_joint_base_axes")
    elif parameters["leg_spin"] == "universal":
        raise PlantError("platform: leg_spin universal needs universal_joint_base_axes")
    return parameters | {
        "force_bandwidth": settings.force_bandwidth_Hz,
        "viscous_friction": [settings.viscous_friction_N_s_m] * 6,
        "coulomb_friction": [settings.coulomb_friction_N] * 6,
        "reflected_mass": [settings.reflected_mass_kg] * 6,
        "brake_force": [settings.brake_force_N] * 6,
        "length_min": _floats(length_min, (6,), "length_min"),
        "length_max": _floats(length_max, (6,), "length_max"),
        "initial_position": _floats(p0, (3,), "p0"),
        "initial_rotation": _floats(R0, (3, 3), "R0"),
        "initial_twist": _floats(np.zeros(6) if twist0 is None else twist0, (6,), "twist0"),
        "internal_step": settings.internal_step_us / 1e6,
    }


def stewart_plant(
    settings: StewartPlant,
    platform: Mapping[str, Any],
    length_min: Array,
    length_max: Array,
    p0: Array,
    R0: Array,
    twist0: Array | None = None,
) -> Plant:
    """Build our FMU (or take it from the cache) and host it with `stewart_parameters`; `truth()` is known.

    Raises PlantError: no compiler, a robot without meaning, an initial pose outside the strokes.
    """
    names = TruthNames("position", "rotation", "twist", "applied_force")
    spec = FmuSpec(
        path=build(settings.fmi_version),
        force=("force",),
        length=("length",),
        rate=("rate",),
        brake=("brake",),
        wrench=("wrench",),
        parameters=stewart_parameters(settings, platform, length_min, length_max, p0, R0, twist0),
        step_s=settings.internal_step_us / 1e6,
        truth=names,
    )
    return host(spec, settings.isolation)


def open_plant(
    settings: PlantSettings,
    platform: Mapping[str, Any],
    length_min: Array,
    length_max: Array,
    p0: Array,
    R0: Array,
    folder: Path,
) -> Plant:
    """Open the plant of a configuration.

    settings: section `plant`; platform, length_min, length_max, p0, R0: the robot and its initial pose, as
    for `stewart_plant` (a bench or foreign FMU ignores them); folder: the configuration's, where a relative
    FMU path starts. Raises PlantError.
    """
    model = settings.model
    if isinstance(model, StewartPlant):
        return stewart_plant(model, platform, length_min, length_max, p0, R0)
    if isinstance(model, BenchPlant):
        return Bench(model)
    assert isinstance(model, FmuPlant)
    return host(spec_from_settings(model, folder), model.isolation)
