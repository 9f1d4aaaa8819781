"""The controller's model of the robot: masses, friction, variant."""

from typing import Literal, Self

from pydantic import model_validator

from drivers.section import Section
from hil.config.values import NonNegative, Pose, Positive, SixNonNegative


class MechanicsSettings(Section):
    """Masses and friction in the controller's model."""

    inertia_scale: Positive = 1.0
    """Factor on all masses, all inertias and the platform's centre of mass. The centres of mass along the
    legs stay exact, as do lengths, J, its rate, gravity and friction."""
    reflected_mass_kg: NonNegative | SixNonNegative = 0.0
    """Reflected mass of motor and screw: rotary inertia times (2 pi / lead)^2. One for all legs, or one per
    leg, as for the friction."""
    viscous_friction_N_s_m: NonNegative | SixNonNegative = 0.0
    coulomb_friction_N: NonNegative | SixNonNegative = 0.0
    sliding_speed_m_s: NonNegative = 1e-3
    """Leg rate above which Coulomb friction acts in full; below, it grows linearly. 0: sgn of the rate."""


class ModelSettings(MechanicsSettings):
    """The controller's model of the robot."""

    variant: Literal["full", "no_H", "printed", "constant", "constant_MG", "massless_legs"] = "full"
    frozen_at: Pose | None = None
    """Pose of the constant variants."""

    @model_validator(mode="after")
    def _frozen_somewhere(self) -> Self:
        constant = self.variant in {"constant", "constant_MG"}
        if constant != (self.frozen_at is not None):
            raise ValueError(
                "the variants constant and constant_MG need frozen_at, allowed: with these variants "
                f"only, given: variant {self.variant} with{'out' * constant} it"
            )
        return self
