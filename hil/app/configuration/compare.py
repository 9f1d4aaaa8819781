"""Section `compare`: which laws `hil compare` runs, and what disturbs them."""

from typing import Annotated, Self

from pydantic import AfterValidator, Field, model_validator

from drivers.section import Section
from hil.config.values import Axis, NonNegative, Positive, Vector3
from hil.control import ControllerSettings


def _no_comma(name: str) -> str:
    if not name.strip() or "," in name:
        raise ValueError(f"no name of a law, allowed: text without a comma, given: {name!r}")
    return name


class DisturbanceSettings(Section):
    """A load ON the platform, at its origin and in the base frame, that comes at once and stays."""

    force_N: Vector3 = (0.0, 0.0, 0.0)
    moment_N_m: Vector3 = (0.0, 0.0, 0.0)
    start_s: NonNegative = 0.0
    """Along the reference."""
    stop_s: Positive | None = None
    """Default: to the end."""

    @model_validator(mode="after")
    def _some_time(self) -> Self:
        if self.stop_s is not None and self.stop_s <= self.start_s:
            allowed = f"allowed: more than {self.start_s:g}, given: {self.stop_s:g}"
            raise ValueError(f"stop_s is not after start_s, {allowed}")
        return self


class StepSettings(Section):
    """The step of the set-point at home whose answer gives rise time, overshoot and bandwidth."""

    axis: Axis = "z_m"
    size: Annotated[float, Field(gt=0)] = 0.001
    """In the axis' unit. Small: the answer is to be the loop's, not a limit's."""


class CompareSettings(Section):
    """What `hil compare` compares."""

    laws: dict[Annotated[str, AfterValidator(_no_comma)], ControllerSettings] = {}
    """Name -> settings as in section `controller`. Default: every law, gains from the configuration's."""
    disturbance: DisturbanceSettings | None = None
    inertia_scale: Positive = 1.0
    """What every law believes the masses to be, as a share of what it would: 0.9 is 10 % too light."""
    step: StepSettings = StepSettings()
