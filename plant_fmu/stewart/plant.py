"""Our FMU as a plant: the parameters of a robot, and the hosting."""

from typing import Any

import numpy as np

from drivers.errors import PlantError
from plant_fmu.config import StewartPlant
from plant_fmu.fmu.check import FmuSpec, Parameter
from plant_fmu.fmu.child import host
from plant_fmu.plant import Plant, Robot
from plant_fmu.stewart.build import build


def _floats(value: Any, shape: tuple[int, ...], name: str) -> list[float]:
    try:
        array = np.asarray(value, np.float64)
    except (TypeError, ValueError) as error:
        raise PlantError(f"platform: {name}: {value!r} is not numeric") from error
    if array.shape != shape:
        raise PlantError(f"platform: {name} has shape {array.shape}; {shape} is needed")
    return [float(x) for x in array.ravel()]


def stewart_parameters(settings: StewartPlant, robot: Robot) -> dict[str, Parameter]:
    """Return our FMU's parameters for one robot. Raises PlantError on a missing key or a wrong shape."""
    platform = robot.platform
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
        "length_min": _floats(robot.length_min, (6,), "length_min"),
        "length_max": _floats(robot.length_max, (6,), "length_max"),
        "initial_position": _floats(robot.p0, (3,), "p0"),
        "initial_rotation": _floats(robot.R0, (3, 3), "R0"),
        "internal_step": settings.internal_step_us / 1e6,
    }


def stewart_plant(settings: StewartPlant, robot: Robot) -> Plant:
    """Build our FMU (or take it from the cache) and host it with `stewart_parameters`; `truth()` is known.

    Raises PlantError: no compiler, a robot without meaning, an initial pose outside the strokes.
    """
    spec = FmuSpec(
        path=build(settings.fmi_version),
        force=("force",),
        length=("length",),
        rate=("rate",),
        brake=("brake",),
        wrench=("wrench",),
        parameters=stewart_parameters(settings, robot),
        step_s=settings.internal_step_us / 1e6,
        truth=("position", "rotation", "twist", "applied_force"),
    )
    return host(spec, settings.isolation)
