"""The bounded uncertainty that a robust law masters, and how it is stated."""

from typing import Annotated, Self

from pydantic import Field, model_validator

from drivers.section import Section
from hil.config.values import NonNegative, Positive

ASSUMED_m_s2 = 0.1 * 9.81
"""Disturbance that robust laws are made for by default: a tenth of gravity."""


class UncertaintySettings(Section):
    """What a robust law has to master: a bound on what its model does not know, as accelerations of a leg.

    Legs that obey M ddq + h = tau + f (M leg-space inertia, f what is not in the model) accelerate under the
    model's forces for an acceleration ddq* by ddq* + d. Where inertia and weight are wrong by no more than a
    share alpha, |d| <= disturbance + alpha (acceleration + bound), hence

        bound = (disturbance + alpha acceleration) / (1 - alpha)

    The law's linear part, lambda de or K_D de + K_P e, is part of that acceleration.
    """

    disturbance_m_s2: NonNegative
    """Of loads and friction that are not in the model, divided by the inertia: at most row by row
    |J M^-1 wrench|. 10 kN on the book's platform are up to 6.3 along an axis, 7.9 in the worst direction."""
    model_error: Annotated[float, Field(ge=0, lt=1)] = 0.0
    """alpha, relative error of the model's inertia and weight: 0.1 for an inertia_scale of 0.9."""
    acceleration_m_s2: Positive | None = None
    """What that error acts on: the largest leg force of the reference, weight included, over the inertia, and
    the acceleration that the law's linear part adds."""

    @model_validator(mode="after")
    def _error_of_something(self) -> Self:
        if self.model_error > 0 and self.acceleration_m_s2 is None:
            raise ValueError(
                "acceleration_m_s2 is missing: model_error is a share of it, state the largest acceleration "
                "of a leg, of the reference and the weight together"
            )
        if self.model_error == 0 and self.disturbance_m_s2 == 0:
            raise ValueError(
                "nothing is uncertain: a robust law needs disturbance_m_s2 > 0 or model_error > 0, or take "
                "law: inverse_dynamics"
            )
        return self

    def bound(self, margin: float = 0.0) -> float:
        """Return the acceleration of a leg, m/s^2, that masters all of it with `margin` (m/s^2) to spare."""
        acceleration = self.acceleration_m_s2 or 0.0
        return (self.disturbance_m_s2 + self.model_error * acceleration + margin) / (1.0 - self.model_error)
