"""Input file of `hil design`: an axis, the inputs of its controller, and the requirements on the loop."""

from math import pi
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from drivers.section import Section
from hil.config.axis_model import AxisSpace
from hil.config.delay import Delay
from hil.config.linear_controller import ControllerInput
from hil.config.values import Positive


class TransferFunction(Section):
    """Rational function of s in rad/s; coefficient of the highest power first."""

    numerator: Annotated[list[float], Field(min_length=1)]
    denominator: Annotated[list[float], Field(min_length=1)]


class DesignAxis(Section):
    """Demanded acceleration to position: gain exp(-transport s) / (lag s + 1) / s^2, after a hold."""

    gain: Positive = 1.0
    """Measured over demanded acceleration; 1 where model and robot agree."""
    transport_ms: Delay
    """Pure delay: feedback, computing, command. `hil identify` measures it."""
    lag_ms: Delay
    """Time constant of the drives' force loop, first order: 1000 / (2 pi bandwidth in Hz)."""
    drive: TransferFunction | None = None
    """Drive dynamics beyond that lag: a force loop of higher order, a resonance. Gain 1 at rest."""


class DisturbanceWeight(Section):
    """Acceleration on the axis that the law does not know: loads, friction, model errors."""

    amplitude_m_s2: Positive
    """On rotation axes rad replaces m in the units of all weights."""


class ErrorWeight(Section):
    """Allowed position error under the disturbance: `low` at rest, rising to `peak` above `bandwidth`."""

    low_m: Positive
    """Allowed error under a constant disturbance. A smaller value makes the controller integrate more."""
    peak_m: Positive
    """Allowed error under a disturbance at the worst frequency."""
    bandwidth_rad_s: Positive
    """Frequency above which `peak` is allowed; below it proportionally less, down to `low`."""

    @model_validator(mode="after")
    def _low_is_low(self) -> Self:
        if self.low_m >= self.peak_m:
            raise ValueError(f"low_m is {self.low_m:g}, allowed: below peak_m, {self.peak_m:g}")
        return self


class ControlWeight(Section):
    """Allowed acceleration that the controller demands under disturbance and noise."""

    limit_m_s2: Positive
    """Limit at low frequency. Divided by the disturbance's amplitude it bounds the peak of T."""
    roll_off_rad_s: Positive | None = None
    """Frequency above which proportionally less is allowed: noise and unmodelled dynamics act there."""


class NoiseWeight(Section):
    """Errors of the measurements; their ratio decides which measurement the controller trusts more."""

    error_m: Positive
    """Encoder error: resolution and compliance between encoder and load."""
    rate_error_m_s: Positive | None = None
    """Error of the measured rate; required if `inputs` lists rate_error, otherwise not allowed."""


class DesignWeights(Section):
    """Requirements on the loop. Synthesis returns gamma; gamma <= 1 means that all are met."""

    disturbance: DisturbanceWeight
    error: ErrorWeight | TransferFunction
    """Allowed error, or the weight itself as a transfer function, 1/m."""
    control: ControlWeight | TransferFunction
    """Allowed acceleration, or the weight itself as a transfer function, s^2/m."""
    noise: NoiseWeight


class UncertaintyRanges(Section):
    """Uncertainties that the controller must tolerate together; `hil design mu` proves it by mu < 1."""

    inertia: Annotated[float, Field(gt=0, lt=1)]
    """Relative error of mass and inertia: 0.2 for +-20 %."""
    transport_ms: tuple[Delay, Delay]
    """Range of the pure delay of feedback, computing and command."""
    drive_bandwidth_Hz: tuple[Positive, Positive]
    """Range of the corner frequency of the drives' force loop, first order."""

    @model_validator(mode="after")
    def _ranges(self) -> Self:
        for name in ("transport_ms", "drive_bandwidth_Hz"):
            low, high = getattr(self, name)
            if low >= high:
                raise ValueError(f"{name} goes from {low:g} to {high:g}, allowed: the smaller value first")
        return self

    @property
    def lag_ms(self) -> tuple[float, float]:
        """Smallest and largest time constant of the drives, ms: 1000 / (2 pi bandwidth)."""
        slow, fast = self.drive_bandwidth_Hz
        return 1000.0 / (2.0 * pi * fast), 1000.0 / (2.0 * pi * slow)


class Design(Section):
    """Content of the input file of `hil design`: one controller for each of six equal axes."""

    kind: Literal["design"]
    description: str = ""
    axes: AxisSpace = "joint"
    rate_Hz: Positive
    """Rate of the loop that will run the controller."""
    inputs: Annotated[list[ControllerInput], Field(min_length=1, max_length=2)] = ["error", "rate_error"]
    nominal: DesignAxis | None = None
    """Parameters of the axis; instead of `model`."""
    model: str | None = None
    """File of `hil identify`, relative to this file, instead of `nominal`; `--model` overrides both."""
    delay_order: Annotated[int, Field(ge=1, le=4)] = 1
    """Order of the Pade approximation of transport plus half a period."""
    lump_lag: bool = False
    """Treat the lag as extra dead time: one state fewer, and no fast controller pole that cancels the lag."""
    weights: DesignWeights
    uncertainty: UncertaintyRanges | None = None
    """Uncertainties for `hil design mu`."""

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if len(set(self.inputs)) != len(self.inputs):
            raise ValueError("inputs lists an entry twice, allowed: each once")
        if "error" not in self.inputs:
            raise ValueError(
                "inputs lacks error, allowed: error, rate_error; the rate alone cannot hold a position"
            )
        if (self.weights.noise.rate_error_m_s is None) != ("rate_error" not in self.inputs):
            raise ValueError(
                "noise.rate_error_m_s and the input rate_error go together, allowed: both or neither"
            )
        if self.nominal is not None and self.model is not None:
            raise ValueError("nominal and model both define the axis, allowed: one of them")
        return self
