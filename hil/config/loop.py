"""Section `loop`: the fixed rate and how it is held."""

from typing import Annotated, Literal

from pydantic import Field

from drivers.section import Section
from hil.config.values import Positive


class LoopSettings(Section):
    """The fixed-rate loop."""

    rate_Hz: Annotated[float, Field(ge=1, le=100_000)] = 1000.0
    feedback_window_us: Positive | None = None
    """Longest wait for the six feedbacks after SYNC; default 75 % of the period."""
    cpu: Annotated[int, Field(ge=0, le=1023)] | None = None
    """CPU to pin the loop to (only together with SCHED_FIFO)."""
    priority: Annotated[int, Field(ge=1, le=99)] = 80
    """SCHED_FIFO priority."""
    spin_us: Annotated[float, Field(ge=0, le=10_000)] = 100.0
    """Busy-wait this long before each deadline."""
    without_realtime: Literal["slow", "refuse"] = "slow"
    """Without SCHED_FIFO, or where `--plant` finds it not kept: drop to a rate that holds, or refuse."""
    on_stall: Literal["stretch", "fault"] = "stretch"
    """With `--plant`, or at a served bench, on localcan, while this machine holds one side up: let bench time
    stand still, or go on as on hardware, where a long stall ends in a fault."""

    def window_s(self, rate_Hz: float) -> float:
        """Return the longest wait for the six feedbacks at a rate, s."""
        return 0.75 / rate_Hz if self.feedback_window_us is None else self.feedback_window_us * 1e-6
