"""The base of all sections of the configuration, whichever package owns them."""

from pydantic import BaseModel, ConfigDict


class Section(BaseModel):
    """A section: unknown keys refused, values frozen, NaN refused; validators are built on first use."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, defer_build=True)
