"""Builds the controller's model of the robot from the `model` settings of a law."""

import numpy as np

from hil.config.model import ModelSettings
from hil.config.values import LegSpin
from hil.mathematics.rotations import rotation_from_vector
from hil.robot.dynamics import Model
from hil.robot.geometry import Platform


def build_model(settings: ModelSettings, platform: Platform, leg_spin: LegSpin) -> Model:
    """Model of the robot with the variant, frozen pose, friction and scaling of a law's `model` settings."""
    frozen = settings.frozen_at
    return Model(
        platform,
        settings.variant,
        leg_spin,
        inertia_scale=settings.inertia_scale,
        reflected_mass=settings.reflected_mass_kg,
        viscous=settings.viscous_friction_N_s_m,
        coulomb=settings.coulomb_friction_N,
        sliding_speed=settings.sliding_speed_m_s,
        frozen_at=None
        if frozen is None
        else (
            np.array(frozen.position_m, float),
            rotation_from_vector(np.deg2rad(frozen.rotation_vector_deg)),
        ),
    )
