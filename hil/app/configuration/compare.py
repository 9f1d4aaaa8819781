"""Section `compare`: laws that `hil compare` runs, and their disturbances."""

from typing import Annotated, Self

from pydantic import AfterValidator, Field, model_validator

from drivers.section import Section
from hil.config.values import Axis, NonNegative, Positive, Vector3
from hil.control import ControllerSettings


def _no_comma(name: str) -> str:
    if not name.strip() or "," in name:
        raise ValueError(f"invalid name of a law, allowed: text without a comma, given: {name!r}")
    return name


class DisturbanceSettings(Section):
    """A load on the platform, at its origin and in the base frame, that starts as a step and stays."""

    force_N: Vector3 = (0.0, 0.0, 0.0)
    moment_N_m: Vector3 = (0.0, 0.0, 0.0)
    start_s: NonNegative = 0.0
    """Time along the reference."""
    stop_s: Positive | None = None
    """Default: to the end."""

    @model_validator(mode="after")
    def _some_time(self) -> Self:
        if self.stop_s is not None and self.stop_s <= self.start_s:
            allowed = f"allowed: more than {self.start_s:g}, given: {self.stop_s:g}"
            raise ValueError(f"stop_s is not after start_s, {allowed}")
        return self


class StepSettings(Section):
    """Step of the set-point at home; the response gives rise time, overshoot and bandwidth."""

    axis: Axis = "z_m"
    size: Annotated[float, Field(gt=0)] = 0.001
    """In the unit of the axis. Keep it small, so that no limit shapes the response."""


class CompareSettings(Section):
    """Settings of `hil compare`."""

    laws: dict[Annotated[str, AfterValidator(_no_comma)], ControllerSettings] = {}
    """Name -> settings as in section `controller`. Default: every law, with the gains of the
    configuration."""
    disturbance: DisturbanceSettings | None = None
    inertia_scale: Positive = 1.0
    """Factor on the masses that every law assumes: 0.9 is 10 % too light."""
    step: StepSettings = StepSettings()
