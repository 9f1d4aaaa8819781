"""Section `limits`: what safety refuses."""

from typing import Annotated, Self

from pydantic import Field, model_validator

from drivers.section import Section
from hil.config.values import NonNegative, Positive


class LimitSettings(Section):
    """Safety limits of the controller."""

    force_N: Positive
    """Per leg."""
    force_step_N: Positive
    """Largest change of a leg's force from one tick to the next."""
    force_window_N: Positive
    """Largest change of a leg's force within 250 ms."""
    speed_m_s: Positive
    """Leg speed; faults above."""
    acceleration_m_s2: Positive | None = None
    """Leg acceleration that the reference may ask for; checked before the run. Default: not limited."""
    deceleration_m_s2: Positive
    """The square-root speed cap before the soft ends: |dq| <= sqrt(2 a distance)."""
    stroke_margin_m: NonNegative = 0.0
    """Soft ends lie this far inside length_min_m and length_max_m."""
    following_error_m: Positive
    """Leg error that faults at rest."""
    following_error_s: NonNegative = 0.0
    """Added per m/s of reference leg rate."""
    standstill_m: Positive = 5e-4
    """A leg that moves farther on its closed brake is a fault. More than brakes give way under load, and more
    than encoders are uncertain by."""
    consistency_m: Positive = 1e-4
    """Residual of forward kinematics that faults."""
    condition: Positive = 50.0
    """Condition number of J (lengths made comparable) that faults."""
    stale_warn_ticks: Annotated[int, Field(ge=1, le=1000)] = 2
    stale_fault_ticks: Annotated[int, Field(ge=1, le=1000)] = 5
    sync_skew_us: Positive | None = None
    """Several buses: a tick whose SYNCs are farther apart counts as late, for its legs are not read at one
    instant. Default: a tenth of the period."""
    missed_stop_ticks: Annotated[int, Field(ge=1, le=1000)] = 5
    """Periods missed in a row that ask for a controlled stop."""
    stretch_percent: Annotated[float, Field(ge=0, le=100)] = 5.0
    """Share of the run for which the time of a virtual bench may stand still in stretches of 4 ms and more,
    beside half a second: more asks for a controlled stop. See `loop.on_stall`."""

    @model_validator(mode="after")
    def _warn_before_fault(self) -> Self:
        if self.stale_warn_ticks > self.stale_fault_ticks:
            raise ValueError(
                f"stale_warn_ticks is above stale_fault_ticks, allowed: at most {self.stale_fault_ticks}, "
                f"given: {self.stale_warn_ticks}"
            )
        return self
