"""The robot behind the answers of `hil new`: its section `platform`, and what it needs at home."""

from __future__ import annotations

from math import sqrt
from typing import Any, NamedTuple

import numpy as np

from drivers.arrays import Array
from hil.app.configuration.platform import build_platform, joint_list, pose_arrays
from hil.app.new.text import DIGITS
from hil.config.platform import JointCircle, PlatformSettings
from hil.mathematics.rounding import rounded
from hil.robot.dynamics import Model
from hil.robot.geometry import Platform
from hil.robot.kinematics import condition, jacobian

HOLD_SHARE = 0.5
"""Of the rated force, what holding the platform at home may take."""
WORST_CONDITION = 25.0
"""Of J at home: half of the default of limits.condition."""
LOWER_SHARE = 0.7
"""Of a leg's mass, what does not move with the rod: housing, motor, brake, screw."""
GRAVITY_m_s2 = 9.81


class AtHome(NamedTuple):
    """What the robot needs at mid-stroke, at rest."""

    platform: Platform
    pose: tuple[Array, Array]
    """Position (3,) m and rotation (3, 3) at home."""
    model: Model
    J: Array
    """(6, 6), dq = J twist."""
    static_N: Array
    """(6,) N."""
    leg_mass_kg: float
    """Largest eigenvalue of J^-T M J^-1: what six legs feel that move together at worst."""


def circles(a: dict[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return base and platform joints as the configuration has them; leg 0 goes to the last platform pair."""
    base = {
        "radius_m": a["base_radius_m"],
        "pair_centres_deg": [0.0, 120.0, 240.0],
        "pair_half_angle_deg": a["base_half_angle_deg"],
    }
    top = {
        "radius_m": a["platform_radius_m"],
        "pair_centres_deg": [60.0, 180.0, 300.0],
        "pair_half_angle_deg": a["platform_half_angle_deg"],
        "pairs_begin": "second_leg",
    }
    return base, top


def joints_apart_m(a: dict[str, Any]) -> float:
    """Return how far the joints of a leg stand beside each other, seen from above, m; equal for all six."""
    base, top = (np.array(joint_list(JointCircle.model_validate(circle))) for circle in circles(a))
    return float(np.hypot(*(top[0] - base[0])[:2]))


def home_height_m(a: dict[str, Any]) -> float:
    """Return the platform's height with all legs at mid-stroke, m: q^2 = d^2 + h^2.

    d is `joints_apart_m`, which is below the retracted length.
    """
    q = a["length_min_m"] + a["stroke_m"] / 2
    return sqrt(q * q - joints_apart_m(a) ** 2)


def estimated_inertia(a: dict[str, Any]) -> list[float]:
    """Return the moments (3,) kg m^2 of a thin disc of the mass and the radius of the platform joints.

    To a digit less than is written: the moment about the axis has to stay the sum of the others.
    """
    across = rounded(a["mass_kg"] * a["platform_radius_m"] ** 2 / 4, DIGITS - 1)
    return [across, across, 2 * across]


def platform_section(a: dict[str, Any]) -> dict[str, Any]:
    """Return section `platform`.

    Leg halves are uniform rods of the retracted length: I = m l^2 / 12.
    """
    base, top = circles(a)
    moments = a["inertia_kg_m2"] or estimated_inertia(a)
    length = a["length_min_m"]

    def half(share: float) -> dict[str, float]:
        m = share * a["leg_mass_kg"]
        return {"mass_kg": m, "com_m": length / 2, "inertia_transverse_kg_m2": m * length * length / 12}

    down = -1.0 if a["mounting"] == "standing" else 1.0
    return {
        "base_joints_m": base,
        "platform_joints_m": top,
        "platform": {
            "mass_kg": a["mass_kg"],
            "com_m": [0.0, 0.0, a["com_height_m"]],
            "inertia_kg_m2": np.diag(moments).tolist(),
        },
        "cylinder": half(LOWER_SHARE),
        "rod": half(1.0 - LOWER_SHARE),
        "gravity_m_s2": [0.0, 0.0, down * GRAVITY_m_s2],
        "home": {"position_m": [0.0, 0.0, home_height_m(a)]},
        "length_min_m": length,
        "length_max_m": length + a["stroke_m"],
    }


def condition_at_home(a: dict[str, Any]) -> float:
    """Return the condition number of J at home; it needs the geometry alone."""
    settings = PlatformSettings.model_validate(platform_section(_NOT_ASKED | a))
    return float(condition(build_platform(settings), *pose_arrays(settings.home)))


def robot_at_home(a: dict[str, Any]) -> AtHome:
    """Return what the answers so far make of the robot; what was not asked yet counts nothing.

    Raises GeometryError: no body has these moments of inertia.
    """
    a = _NOT_ASKED | a
    settings = PlatformSettings.model_validate(platform_section(a))
    platform, home, still = build_platform(settings), pose_arrays(settings.home), np.zeros(6)
    model = Model(platform, reflected_mass=np.full(6, a["reflected_mass_kg"]))
    J = jacobian(platform, *home)
    M = np.linalg.solve(J.T, np.linalg.solve(J.T, model.mass_matrix(*home)).T)
    return AtHome(
        platform,
        home,
        model,
        J,
        model.inverse_dynamics(*home, still, still),
        float(np.linalg.eigvalsh((M + M.T) / 2).max()),
    )


_NOT_ASKED: dict[str, Any] = {
    "mounting": "standing", "mass_kg": 1.0, "com_height_m": 0.0, "inertia_kg_m2": None, "leg_mass_kg": 0.0,
    "reflected_mass_kg": 0.0,
}  # fmt: skip
"""Enough for the geometry, where only that has been asked."""
