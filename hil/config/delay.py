"""What lies between a measurement and the force that answers it."""

from typing import Annotated, Self

from pydantic import Field, model_validator

from drivers.section import Section

Delay = Annotated[float, Field(ge=0, le=50)]
"""ms; what takes longer is no delay but a mistaken unit."""


class ForceDelay(Section):
    """From the instant at which the encoders are latched to the force in the legs."""

    bus_ms: Delay = 0.0
    """Until the drives have the command: SYNC to feedback, computing, command. Pure delay."""
    drive_lag_ms: Delay = 0.0
    """Time constant of the drives' force loop, first order: 1000 / (2 pi bandwidth in Hz)."""


class DelayCompensation(ForceDelay):
    """Compute for the instant at which the force acts, bus + lag + hold after the measurement."""

    hold_ms: Delay = 0.0
    """Half a period: a force that is held for a period acts, on average, so late."""

    @model_validator(mode="after")
    def _some_delay(self) -> Self:
        if self.bus_ms + self.drive_lag_ms + self.hold_ms == 0.0:
            raise ValueError(
                "no delay at all, allowed: one of its keys above 0 (`hil identify --delay` measures them); "
                "or leave the section out"
            )
        return self
