"""Section `monitor`: what may disturb legs and encoders, and the loop's certificate, which is watched."""

from typing import Annotated, Literal

from pydantic import Field

from drivers.section import Section
from hil.config.delay import Delay
from hil.config.values import NonNegative, Positive


class MonitorSettings(Section):
    """What is done where the error grows as its Lyapunov function forbids."""

    action: Literal["log", "warn", "fault"] = "log"
    """`log` records V, its rate and its bound; `warn` warns, too (CERTIFICATE); `fault` ends the run."""
    disturbance_m_s2: Positive = 8.0
    """Acceleration of a leg, or of the platform along an axis, that need not alarm: of loads, friction and
    whatever else is not in the law's model. 10 kN on the book's platform are up to 7.9 in a leg."""
    disturbance_rad_s2: Positive = 8.0
    """The same of the platform about an axis, for laws in pose space."""
    confirm_ticks: Annotated[int, Field(ge=1)] = 3
    """So many ticks in a row have to say it."""
    length_noise_m: NonNegative = 2e-6
    """Largest deviation of a reading of a length from the true one: the encoder's step, or 3 to 4 standard
    deviations of its noise. No reading may be off by more."""
    rate_noise_m_s: NonNegative = 1e-4
    """Largest deviation of a measured leg rate, as of the length."""
    rate_skew_us: NonNegative = 50.0
    """So far beside the length a leg rate may be latched, filtered or computed."""
    rate_error_percent: NonNegative = 1.0
    """Share of a leg rate that may be wrong: scale."""
    friction_N: NonNegative | None = None
    """Dry friction that may hold a leg still. Default: the largest that the law's model and the virtual plant
    have; without a plant, or with an FMU of one's own, at least 5 % of the smallest of limits.force_N,
    limits.force_window_N and drives.force_limit_N."""
    drive_lag_ms: Delay = 0.8
    """Time constant of the drives' force loop: 1000 / (2 pi bandwidth in Hz)."""
