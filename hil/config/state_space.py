"""Law of section `controller` that runs a designed linear controller."""

from __future__ import annotations

from typing import Literal, Self

from pydantic import model_validator

from hil.config.model_based import ModelBasedSettings


class StateSpaceSettings(ModelBasedSettings):
    """A controller of `hil design` around inverse dynamics: ddq* = ddq_d + u, in the file's axes."""

    law: Literal["state_space"]
    controller_file: str
    """What `hil design` wrote, relative to this file's folder, or the name of a shipped one: hinf."""

    @model_validator(mode="after")
    def _no_looking_ahead(self) -> Self:
        if self.delay_compensation is not None:
            raise ValueError(
                "delay_compensation has no meaning for law state_space: its controller was designed for an "
                "axis with the delay in it, and one that looks ahead is another axis; leave it out"
            )
        return self
