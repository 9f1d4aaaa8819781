"""Base of all sections of the configuration, in every package."""

from pydantic import BaseModel, ConfigDict


class Section(BaseModel):
    """A section: values frozen, unknown keys and NaN refused; validators are built on first use."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, defer_build=True)
