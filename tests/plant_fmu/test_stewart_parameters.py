"""Parameters of our FMU from a robot: each figure, different from all others, under its own name."""

from __future__ import annotations

from typing import Any

import numpy as np

from plant_fmu.config import StewartPlant
from plant_fmu.plant import Robot
from plant_fmu.stewart.plant import stewart_parameters

SIX_BY_3 = np.arange(18.0).reshape(6, 3)
PLATFORM: dict[str, Any] = {
    "base_joints": SIX_BY_3 + 100.0,
    "platform_joints": SIX_BY_3 + 200.0,
    "platform": {"mass": 7.0, "com": [0.1, 0.2, 0.3], "inertia": np.arange(9.0).reshape(3, 3) + 300.0},
    "cylinder": {"mass": 2.0, "com": 0.4, "inertia_axial": 0.01, "inertia_transverse": 0.5},
    "rod": {"mass": 3.0, "com": 0.6, "inertia_axial": None, "inertia_transverse": 0.7},
    "gravity": [1.0, 2.0, -9.0],
    "leg_spin": "universal",
    "universal_joint_base_axes": SIX_BY_3 + 400.0,
}
ROBOT = Robot(
    PLATFORM,
    length_min=np.arange(6.0) + 1.0,
    length_max=np.arange(6.0) + 11.0,
    p0=np.array([0.7, 0.8, 0.9]),
    R0=np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
)
SETTINGS = StewartPlant(
    type="stewart",
    force_bandwidth_Hz=21.0,
    viscous_friction_N_s_m=22.0,
    coulomb_friction_N=23.0,
    reflected_mass_kg=24.0,
    brake_force_N=25.0,
    internal_step_us=50.0,
)


def test_each_configured_property_of_a_robot_sets_the_corresponding_fmu_parameter():
    assert stewart_parameters(SETTINGS, ROBOT) == {
        "base_joints": [100.0 + k for k in range(18)],
        "platform_joints": [200.0 + k for k in range(18)],
        "mass": 7.0,
        "com": [0.1, 0.2, 0.3],
        "inertia": [300.0 + k for k in range(9)],
        "gravity": [1.0, 2.0, -9.0],
        "cylinder_mass": 2.0,
        "cylinder_com": 0.4,
        "cylinder_inertia": [0.01, 0.5],
        "rod_mass": 3.0,
        "rod_com": 0.6,
        "rod_inertia": [0.0, 0.7],
        "leg_spin": "universal",
        "universal_joint_base_axes": [400.0 + k for k in range(18)],
        "force_bandwidth": 21.0,
        "viscous_friction": [22.0] * 6,
        "coulomb_friction": [23.0] * 6,
        "reflected_mass": [24.0] * 6,
        "brake_force": [25.0] * 6,
        "length_min": [1.0, 2.0, 3.0, 4.0, 5.0, 6.0],
        "length_max": [11.0, 12.0, 13.0, 14.0, 15.0, 16.0],
        "initial_position": [0.7, 0.8, 0.9],
        "initial_rotation": [0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0],
        "internal_step": 5e-5,
    }
