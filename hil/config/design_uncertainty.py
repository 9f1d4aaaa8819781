"""Section `uncertainty` of a design: within what limits the real axis may differ from the nominal one."""

from math import pi
from typing import Annotated, Self

from pydantic import Field, model_validator

from drivers.section import Section
from hil.config.delay import Delay
from hil.config.values import Positive


class UncertaintyRanges(Section):
    """What the controller has to stand at once; mu < 1 says that it does."""

    inertia: Annotated[float, Field(gt=0, lt=1)]
    """Share by which mass and inertia may be off: 0.2 for +-20 %."""
    transport_ms: tuple[Delay, Delay]
    """From, to: pure delay of feedback, computing and command."""
    drive_bandwidth_Hz: tuple[Positive, Positive]
    """From, to: corner of the drives' force loop, first order."""

    @model_validator(mode="after")
    def _ranges(self) -> Self:
        for name in ("transport_ms", "drive_bandwidth_Hz"):
            low, high = getattr(self, name)
            if low >= high:
                raise ValueError(f"{name} goes from {low:g} to {high:g}, allowed: from less to more")
        return self

    @property
    def lag_ms(self) -> tuple[float, float]:
        """Time constants of the drives, ms, least and most: 1000 / (2 pi bandwidth)."""
        slow, fast = self.drive_bandwidth_Hz
        return 1000.0 / (2.0 * pi * fast), 1000.0 / (2.0 * pi * slow)
