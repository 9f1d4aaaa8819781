"""What the controller believes of the robot."""

from typing import Literal, Self

from pydantic import model_validator

from drivers.section import Section
from hil.config.values import NonNegative, Pose, Positive, SixNonNegative


class MechanicsSettings(Section):
    """What the controller believes of masses and friction."""

    inertia_scale: Positive = 1.0
    """All masses, all inertias and the platform's centre of mass times this. The centres of mass along the
    legs stay exact, as do lengths, J, its rate, gravity and friction."""
    reflected_mass_kg: NonNegative | SixNonNegative = 0.0
    """Of motor and screw: rotary inertia times (2 pi / lead)^2. One for all legs, or one each; so below."""
    viscous_friction_N_s_m: NonNegative | SixNonNegative = 0.0
    coulomb_friction_N: NonNegative | SixNonNegative = 0.0
    sliding_speed_m_s: NonNegative = 1e-3
    """Leg rate from which Coulomb friction counts in full; below, it grows linearly. 0: sgn of the rate."""


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
                "frozen_at is for the variants constant and constant_MG, allowed: with them, where it is "
                f"needed, given: variant {self.variant} with{'out' * constant} it"
            )
        return self
