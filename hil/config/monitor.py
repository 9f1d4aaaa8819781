"""Section `monitor`: the certificate of the loop, watched while it runs."""

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
    """What a measured length may be off from one tick to the next: the encoder's step."""
    rate_noise_m_s: NonNegative = 1e-4
    """What a measured leg rate may be off."""
    drive_lag_ms: Delay = 0.8
    """Time constant of the drives' force loop: 1000 / (2 pi bandwidth in Hz)."""
