"""The file that `hil design` reads: an axis, how it is controlled, and what is asked of the loop."""

from math import pi
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from drivers.section import Section
from hil.config.axis_model import AxisSpace
from hil.config.delay import Delay
from hil.config.linear_controller import ControllerInput
from hil.config.values import Positive


class TransferFunction(Section):
    """A rational function of s in rad/s; coefficients of the highest power first."""

    numerator: Annotated[list[float], Field(min_length=1)]
    denominator: Annotated[list[float], Field(min_length=1)]


class DesignAxis(Section):
    """gain exp(-transport s) / (lag s + 1) / s^2, behind a hold of one period."""

    gain: Positive = 1.0
    """Measured over demanded acceleration; 1 where model and robot agree."""
    transport_ms: Delay
    """Pure delay: feedback, computing, command. `hil identify` measures it."""
    lag_ms: Delay
    """Time constant of the drives' force loop, first order: 1000 / (2 pi bandwidth in Hz)."""
    drive: TransferFunction | None = None
    """What the drives do beyond that lag: a force loop of higher order, a resonance. Gain 1 at rest."""


class DisturbanceWeight(Section):
    """The acceleration that acts on the axis without the law's knowledge: loads, friction, a wrong model."""

    amplitude_m_s2: Positive
    """rad/s^2 on an axis that turns; so below."""


class ErrorWeight(Section):
    """The error that is allowed under the disturbance: `low` at rest, `peak` above `bandwidth`."""

    low_m: Positive
    """Of a disturbance that lasts. The smaller, the more the controller integrates."""
    peak_m: Positive
    """Of a disturbance at the worst frequency."""
    bandwidth_rad_s: Positive
    """From here on `peak` is allowed; below, in proportion less, down to `low`."""

    @model_validator(mode="after")
    def _low_is_low(self) -> Self:
        if self.low_m >= self.peak_m:
            raise ValueError(f"low_m is {self.low_m:g}, allowed: below peak_m, {self.peak_m:g}")
        return self


class ControlWeight(Section):
    """The acceleration that the controller may ask for under disturbance and noise."""

    limit_m_s2: Positive
    """At low frequency. Over the disturbance's amplitude it bounds the peak of T."""
    roll_off_rad_s: Positive | None = None
    """Above it, in proportion less: what acts there is noise and what the model does not hold."""


class NoiseWeight(Section):
    """What the measurements are wrong by; the controller trusts them, one against the other, by it."""

    error_m: Positive
    """Encoder: resolution and what bends between encoder and load."""
    rate_error_m_s: Positive | None = None
    """Only with rate_error in `inputs`."""


class DesignWeights(Section):
    """What is asked of the loop. gamma <= 1 says that all of it is reached."""

    disturbance: DisturbanceWeight
    error: ErrorWeight | TransferFunction
    """Or the weight itself, 1/m."""
    control: ControlWeight | TransferFunction
    """Or the weight itself, s^2/m."""
    noise: NoiseWeight


class UncertaintyRanges(Section):
    """What the controller has to stand at once; mu < 1 says that it does."""

    inertia: Annotated[float, Field(gt=0, lt=1)]
    """Share by which mass and inertia may be off: 0.2 for +-20 %."""
    transport_ms: tuple[Delay, Delay]
    """From, to: pure delay of feedback, computing and command."""
    drive_bandwidth_Hz: tuple[Positive, Positive]
    """From, to: corner of the drives' force loop, first order."""

    @model_validator(mode="after")
    def _ranges(self) -> Self:
        for name in ("transport_ms", "drive_bandwidth_Hz"):
            low, high = getattr(self, name)
            if low >= high:
                raise ValueError(f"{name} goes from {low:g} to {high:g}, allowed: from less to more")
        return self

    @property
    def lag_ms(self) -> tuple[float, float]:
        """Time constants of the drives, ms, least and most: 1000 / (2 pi bandwidth)."""
        slow, fast = self.drive_bandwidth_Hz
        return 1000.0 / (2.0 * pi * fast), 1000.0 / (2.0 * pi * slow)


class Design(Section):
    """A design: one controller for each of six axes that are alike."""

    kind: Literal["design"]
    description: str = ""
    axes: AxisSpace = "joint"
    rate_Hz: Positive
    """Of the loop that will run the controller."""
    inputs: Annotated[list[ControllerInput], Field(min_length=1, max_length=2)] = ["error", "rate_error"]
    nominal: DesignAxis | None = None
    """The axis in figures ..."""
    model: str | None = None
    """... or a file of `hil identify`, relative to this one; `--model` goes before both."""
    delay_order: Annotated[int, Field(ge=1, le=4)] = 1
    """Of the Pade approximation of transport and half a period."""
    lump_lag: bool = False
    """Take the lag as further dead time: a state less, and no fast pole of the controller that undoes it."""
    weights: DesignWeights
    uncertainty: UncertaintyRanges | None = None
    """For `hil design mu`."""

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if len(set(self.inputs)) != len(self.inputs):
            raise ValueError("inputs names one twice, allowed: each once")
        if "error" not in self.inputs:
            raise ValueError("inputs lacks error, allowed: error, rate_error; a rate alone holds no position")
        if (self.weights.noise.rate_error_m_s is None) != ("rate_error" not in self.inputs):
            raise ValueError(
                "noise.rate_error_m_s and the input rate_error go together, allowed: both or neither"
            )
        if self.nominal is not None and self.model is not None:
            raise ValueError("nominal and model both say what the axis is, allowed: one of them")
        return self
