"""Our FMU as a plant: its parameters from a robot's data, and its hosting."""

from typing import Any

import numpy as np

from plant_fmu.config import StewartPlant
from plant_fmu.fmu.check import FmuSpec, Parameter
from plant_fmu.fmu.child import host
from plant_fmu.plant import Plant, Robot
from plant_fmu.stewart.build import build


def _flat(value: Any) -> list[float]:
    flat: list[float] = np.asarray(value, np.float64).ravel().tolist()
    return flat


def stewart_parameters(settings: StewartPlant, robot: Robot) -> dict[str, Parameter]:
    """Parameter values of our FMU for one robot."""
    platform = robot.platform
    body = platform["platform"]
    parameters: dict[str, Parameter] = {
        "mass": float(body["mass"]),
        "com": _flat(body["com"]),
        "inertia": _flat(body["inertia"]),
        "leg_spin": str(platform.get("leg_spin") or "none"),
        "force_bandwidth": settings.force_bandwidth_Hz,
        "viscous_friction": [settings.viscous_friction_N_s_m] * 6,
        "coulomb_friction": [settings.coulomb_friction_N] * 6,
        "reflected_mass": [settings.reflected_mass_kg] * 6,
        "brake_force": [settings.brake_force_N] * 6,
        "length_min": _flat(robot.length_min),
        "length_max": _flat(robot.length_max),
        "initial_position": _flat(robot.p0),
        "initial_rotation": _flat(robot.R0),
        "internal_step": settings.internal_step_us / 1e6,
    }
    for name in ("base_joints", "platform_joints", "gravity", "universal_joint_base_axes"):
        if name in platform:
            parameters[name] = _flat(platform[name])
    for half in ("cylinder", "rod"):
        part = platform[half]
        parameters[f"{half}_mass"] = float(part["mass"])
        parameters[f"{half}_com"] = float(part["com"])
        axial = part.get("inertia_axial") or 0.0
        parameters[f"{half}_inertia"] = _flat([axial, part["inertia_transverse"]])
    return parameters


def stewart_plant(settings: StewartPlant, robot: Robot, *_: object) -> Plant:
    """Build our FMU (or take it from the cache) and host it; its true pose is known.

    Raises PlantError: no compiler, invalid data of the robot, an initial pose outside the strokes.
    """
    spec = FmuSpec(
        path=str(build(settings.fmi_version)),
        isolation=settings.isolation,
        force=["force"],
        length=["length"],
        rate=["rate"],
        brake=["brake"],
        wrench=["wrench"],
        parameters=stewart_parameters(settings, robot),
        step_us=settings.internal_step_us,
        truth=["position", "rotation", "twist", "applied_force"],
        rod_force="rod_force",
    )
    return host(spec)
