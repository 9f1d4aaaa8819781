"""Axis model: the file that `hil identify` writes and `hil design` reads, one axis of the linearised loop."""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from drivers.section import Section
from hil.config.delay import Delay
from hil.config.values import NonNegative, Positive, SixPositive

AxisSpace = Literal["joint", "pose"]
"""Six legs, or x, y, z and the rotations about them."""


class NominalAxis(Section):
    """Demanded acceleration to position: gain exp(-transport s) / (lag s + 1) / s^2, after a hold."""

    gain: SixPositive
    """Gain of each axis; 1 where model and robot agree."""
    transport_ms: Delay
    """Pure delay: feedback, computing, command."""
    lag_ms: Delay
    """Time constant of the drives' force loop, first order."""


class UncertaintyProfile(Section):
    """Bound over frequency on the relative error of the nominal axis P0: |P / P0 - 1| <= bound."""

    frequency_Hz: Annotated[list[Positive], Field(min_length=2)]
    """Frequencies in rising order."""
    bound: Annotated[list[Positive], Field(min_length=2)]

    @model_validator(mode="after")
    def _a_function(self) -> Self:
        if len(self.frequency_Hz) != len(self.bound):
            counts = f"{len(self.frequency_Hz)} frequencies and {len(self.bound)} bounds"
            raise ValueError(f"{counts}, allowed: equal numbers")
        if any(b <= a for a, b in zip(self.frequency_Hz, self.frequency_Hz[1:], strict=False)):
            raise ValueError("frequency_Hz does not rise, allowed: each value above the previous one")
        return self


class AxisResponse(Section):
    """Measured frequency response of one axis, from demanded acceleration to position."""

    frequency_Hz: list[Positive]
    magnitude: list[NonNegative]
    """Position over demanded acceleration, s^2."""
    phase_deg: list[float]
    coherence: list[Annotated[float, Field(ge=0, le=1)]]
    magnitude_std: list[NonNegative]
    phase_std_deg: list[NonNegative]


class AxisModel(Section):
    """Content of an axis model file: nominal model, bound of its error, and the measured responses."""

    kind: Literal["axis-model"]
    source: str
    """Log from which the axis was identified."""
    axes: AxisSpace
    rate_Hz: Positive
    nominal: NominalAxis
    uncertainty: UncertaintyProfile
    measured: Annotated[list[AxisResponse], Field(min_length=6, max_length=6)]
