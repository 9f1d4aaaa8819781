"""Laws of section `controller` that master a bounded uncertainty, and how it is stated."""

from __future__ import annotations

from math import inf, sqrt
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from drivers.config import Section
from hil.config.model_based import ModelBasedSettings
from hil.config.values import NonNegative, Positive, SixPositive, largest


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


class SlidingModeSettings(ModelBasedSettings):
    """Sliding mode on the leg lengths with a boundary layer, s = de + lambda e."""

    law: Literal["sliding_mode"]
    lambda_rad_s: Positive
    """Slope of the sliding surface: on it an error decays as exp(-lambda t)."""
    uncertainty: UncertaintySettings
    """The switching gain k is its bound and the reaching acceleration on top."""
    reaching_m_s2: Positive
    """How fast s approaches the boundary layer at least, whatever the uncertainty does."""
    boundary_layer_m_s: NonNegative | None = None
    """phi, the |s| below which the law is linear: |e| <= phi / lambda. Default k / lambda, which gives the
    linear law two poles at lambda; 0 switches, and chatters."""

    @property
    def switching_gain(self) -> float:
        """k, m/s^2."""
        return self.uncertainty.bound(self.reaching_m_s2)

    @property
    def boundary_layer(self) -> float:
        """phi, m/s."""
        phi = self.boundary_layer_m_s
        return self.switching_gain / self.lambda_rad_s if phi is None else phi

    @property
    def linear_gains(self) -> tuple[float, float]:
        """K_P in 1/s^2 and K_D in 1/s inside the boundary layer; infinite where it has no thickness."""
        slope, phi = self.lambda_rad_s, self.boundary_layer
        steepness = self.switching_gain / phi if phi > 0 else inf
        return slope * steepness, slope + steepness


class RobustInverseDynamicsSettings(ModelBasedSettings):
    """Inverse dynamics with an outer loop that masters bounded uncertainty (Lyapunov redesign)."""

    law: Literal["robust_inverse_dynamics"]
    wn_rad_s: Positive | SixPositive
    """Natural frequency of the error dynamics that the Lyapunov function belongs to, K_P = wn^2; one for all
    legs, or one per leg."""
    damping_ratio: Positive = 1.0
    """K_D = 2 zeta wn."""
    uncertainty: UncertaintySettings
    boundary_layer_m_s: NonNegative
    """epsilon, the |de + zeta wn e| over all legs below which the law is linear: |e| <= epsilon / wn at
    damping ratio 1. 0 switches, and chatters."""

    @property
    def bound(self) -> float:
        """rho, m/s^2: the uncertainty of six legs at once."""
        return sqrt(6.0) * self.uncertainty.bound()

    @property
    def linear_gains(self) -> tuple[float, float]:
        """K_P in 1/s^2 and K_D in 1/s of the fastest leg inside the boundary layer; infinite without one."""
        w_n, epsilon = largest(self.wn_rad_s), self.boundary_layer_m_s
        steepness = self.bound / epsilon if epsilon > 0 else inf
        K_D = 2.0 * self.damping_ratio * w_n
        return w_n**2 + steepness * K_D / 2.0, K_D + steepness
