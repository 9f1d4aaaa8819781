"""Settings of the bounded model uncertainty for which a robust control law is designed."""

from typing import Annotated, Self

from pydantic import Field, model_validator

from drivers.section import Section
from hil.config.values import NonNegative, Positive

ASSUMED_m_s2 = 0.1 * 9.81
"""Default disturbance of robust laws: a tenth of gravity."""


class UncertaintySettings(Section):
    """Uncertainty of a robust law: a bound on the model error, as an acceleration of a leg.

    Legs obey M ddq + h = tau + f (M leg-space inertia, f the unmodelled forces). Under the model's forces for
    an acceleration ddq* they accelerate by ddq* + d. If the relative error of inertia and weight is at most
    alpha, |d| <= disturbance + alpha (acceleration + bound), hence

        bound = (disturbance + alpha acceleration) / (1 - alpha)

    The acceleration includes the law's linear part, lambda de or K_D de + K_P e.
    """

    disturbance_m_s2: NonNegative
    """Unmodelled loads and friction divided by the inertia: at most |J M^-1 wrench| of each row. 10 kN on the
    book's platform give up to 6.3 along an axis, 7.9 in the worst direction.
    """
    model_error: Annotated[float, Field(ge=0, lt=1)] = 0.0
    """alpha, relative error of the model's inertia and weight: 0.1 for an inertia_scale of 0.9."""
    acceleration_m_s2: Positive | None = None
    """Acceleration of which the model error is a share: largest leg force of the reference, weight included,
    divided by the inertia, plus the acceleration of the law's linear part."""

    @model_validator(mode="after")
    def _error_of_something(self) -> Self:
        if self.model_error > 0 and self.acceleration_m_s2 is None:
            raise ValueError(
                "acceleration_m_s2 is missing: model_error is a share of it; state the largest acceleration "
                "of a leg from reference and weight together"
            )
        if self.model_error == 0 and self.disturbance_m_s2 == 0:
            raise ValueError(
                "the uncertainty is zero: a robust law needs disturbance_m_s2 > 0 or model_error > 0; "
                "otherwise use law: inverse_dynamics"
            )
        return self

    def bound(self, margin: float = 0.0) -> float:
        """Acceleration, m/s^2, that exceeds any effect of the uncertainty on a leg by `margin`, m/s^2."""
        acceleration = self.acceleration_m_s2 or 0.0
        return (self.disturbance_m_s2 + self.model_error * acceleration + margin) / (1.0 - self.model_error)
