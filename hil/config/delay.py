"""Delay between a measurement and the force that responds to it."""

from typing import Annotated, Self

from pydantic import Field, model_validator

from drivers.section import Section

Delay = Annotated[float, Field(ge=0, le=50)]
"""Delay in ms; a larger value is a unit mistake."""


class ForceDelay(Section):
    """Delay from the instant at which the encoders are sampled to the force in the legs."""

    bus_ms: Delay = 0.0
    """Pure delay until the drives have the command: SYNC to feedback, computing, command."""
    drive_lag_ms: Delay = 0.0
    """Time constant of the drives' force loop, first order: 1000 / (2 pi bandwidth in Hz)."""


class DelayCompensation(ForceDelay):
    """Predict to the instant at which the force acts: bus + lag + hold after the measurement."""

    hold_ms: Delay = 0.0
    """Half a period: the mean delay of a force that is held for one period."""

    @model_validator(mode="after")
    def _some_delay(self) -> Self:
        if self.bus_ms + self.drive_lag_ms + self.hold_ms == 0.0:
            raise ValueError(
                "all delays are 0, allowed: at least one above 0 (`hil identify --delay` measures them); "
                "or leave the section out"
            )
        return self
