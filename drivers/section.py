"""Base class of all sections of the YAML configuration, in every package."""

from pydantic import BaseModel, ConfigDict


class Section(BaseModel):
    """A YAML section: immutable values; unknown keys and NaN are errors; validators built on first use."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, defer_build=True)
