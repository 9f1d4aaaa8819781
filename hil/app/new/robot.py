"""Robot described by the answers to `hil new`: values of section `platform`, and its state at home."""

from __future__ import annotations

from math import cos, radians, sqrt
from typing import Any, NamedTuple

import numpy as np

from drivers.arrays import Array
from hil.app.configuration.platform import build_platform, pose_arrays
from hil.app.new.template import DIGITS, settings
from hil.config.platform import PlatformSettings
from hil.mathematics.rounding import rounded
from hil.robot.dynamics import Model
from hil.robot.geometry import Platform
from hil.robot.kinematics import condition, jacobian

Answers = dict[str, Any]
ESTIMATE = "estimate"
"""Answer for unknown moments of inertia."""
HOLD_SHARE = 0.5
"""Largest holding force at home, as a share of the rated force."""
WORST_CONDITION = 25.0
"""Largest condition number of J at home: half of the default of limits.condition."""
LOWER_SHARE = 0.7
"""Share of a leg's mass that does not move with the rod: housing, motor, brake, screw."""
MOUNTINGS = {"standing": [0.0, 0.0, -9.81], "wall": [-9.81, 0.0, 0.0], "hanging": [0.0, 0.0, 9.81]}
"""Word -> gravity (3,) m/s^2 in the base frame, whose z points from the base to the platform."""
STRONGEST_m_s2 = 100.0
_NOT_ASKED: Answers = {
    "mounting": "standing", "mass_kg": 1.0, "com_height_m": 0.0, "inertia_kg_m2": ESTIMATE,
    "leg_mass_kg": 0.0, "reflected_mass_kg": 0.0, "coulomb_friction_N": 0.0, "viscous_friction_N_s_m": 0.0,
}  # fmt: skip
"""Defaults that are enough for the geometry, before the other questions."""


class AtHome(NamedTuple):
    """State of the robot at home, with all legs at mid-stroke, at rest."""

    platform: Platform
    pose: tuple[Array, Array]
    """Position (3,) m and rotation (3, 3) at home."""
    model: Model
    J: Array
    """(6, 6), dq = J twist."""
    static_N: Array
    """(6,) N, leg forces that hold the platform at home."""
    leg_mass_kg: float
    """Largest eigenvalue of J^-T M J^-1: largest inertia along the legs for any common motion."""

    @property
    def held_N(self) -> float:
        """Largest force of a leg at rest at home, N."""
        return float(np.abs(self.static_N).max())


def joints_apart_m(a: Answers) -> float:
    """Horizontal distance between the two joints of each leg at home, m (law of cosines)."""
    r, s = a["base_radius_m"], a["platform_radius_m"]
    between = radians(60.0 - a["base_half_angle_deg"] - a["platform_half_angle_deg"])
    return sqrt(max(r * r + s * s - 2.0 * r * s * cos(between), 0.0))


def platform_values(a: Answers) -> dict[str, Any]:
    """Values of section `platform`; defaults for questions not yet answered.

    A thin disc of mass m and radius r has the moments m r^2 / 4 and m r^2 / 2. The former is rounded to one
    digit less than is written, so that the axial moment stays the sum of the others. Halves of legs are rods,
    I = m l^2 / 12.
    """
    a = _NOT_ASKED | a
    estimated = a["inertia_kg_m2"] == ESTIMATE
    return {
        **({"circles": True} if "base_joints_m" not in a else {}),
        "com_m": [0.0, 0.0, a["com_height_m"]],
        **({"guessed": True} | _guessed_legs(a) if "cylinder_kg" not in a else {"weighed": True}),
        **({"home": {"position_m": [0.0, 0.0, home_height_m(a)]}} if "home" not in a else {}),
        **a,
        "estimated": estimated,
        "stated": not estimated,
        "inertia": _tensor(a),
        "gravity": MOUNTINGS[a["mounting"]] if isinstance(a["mounting"], str) else a["mounting"],
        "length_max_m": a["length_min_m"] + a["stroke_m"],
    }


def home_height_m(a: Answers) -> float:
    """Height of the platform with all legs at mid-stroke, for joints on circles."""
    q = a["length_min_m"] + a["stroke_m"] / 2
    return sqrt(q * q - joints_apart_m(a) ** 2)  # below the retracted length: `_stroke`


def _tensor(a: Answers) -> Any:
    I = a["inertia_kg_m2"]
    if I == ESTIMATE:
        across = rounded(a["mass_kg"] * a["platform_radius_m"] ** 2 / 4, DIGITS - 1)
        I = [across, across, 2 * across]
    return np.diag(I).tolist() if np.ndim(I) == 1 else I


def _guessed_legs(a: Answers) -> Answers:
    length, leg = a["length_min_m"], a["leg_mass_kg"]
    cylinder = a.get("cylinder_mass_kg", LOWER_SHARE * leg)
    rod = leg - cylinder
    return {
        "cylinder_kg": cylinder,
        "cylinder_com": length / 2,
        "cylinder_inertia": cylinder * length * length / 12,
        "rod_kg": rod,
        "rod_com": length / 2,
        "rod_inertia": rod * length * length / 12,
    }


def platform_settings(a: Answers) -> PlatformSettings:
    """Section `platform` from the answers so far, with defaults."""
    return PlatformSettings.model_validate(settings("platform", platform_values(a)))


def condition_at_home(a: Answers) -> float:
    """Condition number of J at home; needs only the answers about the geometry."""
    s = platform_settings(a)
    return float(condition(build_platform(s), *pose_arrays(s.home)))


def robot_at_home(a: Answers) -> AtHome:
    """Robot at home from the answers so far. Raises GeometryError: impossible moments of inertia."""
    s, a = platform_settings(a), _NOT_ASKED | a
    platform, home, still = build_platform(s), pose_arrays(s.home), np.zeros(6)
    model = Model(
        platform,
        reflected_mass=a["reflected_mass_kg"],
        viscous=a["viscous_friction_N_s_m"],
        coulomb=a["coulomb_friction_N"],
    )
    J = jacobian(platform, *home)
    M = np.linalg.solve(J.T, np.linalg.solve(J.T, model.mass_matrix(*home)).T)
    feel = float(np.linalg.eigvalsh((M + M.T) / 2).max())
    return AtHome(platform, home, model, J, model.inverse_dynamics(*home, still, still), feel)
