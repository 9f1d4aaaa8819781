"""Base class of all sections of the YAML configuration, in every package, and values for each leg."""

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

PerLeg = float | Annotated[list[float], Field(min_length=6, max_length=6)]
"""One value for all legs, or six in leg order."""


def of_leg(value: PerLeg, leg: int) -> float:
    """Value of one leg."""
    return value[leg] if isinstance(value, list) else value


class Section(BaseModel):
    """A YAML section: immutable values; unknown keys and NaN are errors; validators built on first use."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, defer_build=True)
