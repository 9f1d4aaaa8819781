"""Sections `limits`, `monitor` and `reactions`: safety limits, and the reaction to each fault."""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from drivers.section import Section
from drivers.signals import Fault
from hil.config.delay import Delay
from hil.config.values import NonNegative, Positive

Ticks = Annotated[int, Field(ge=1, le=1000)]


class LimitSettings(Section):
    """Safety limits on forces, speeds, positions and timing."""

    force_N: Positive
    """Largest force of a leg."""
    force_step_N: Positive
    """Largest change of a leg's force from one tick to the next."""
    force_window_N: Positive
    """Largest change of a leg's force within 250 ms."""
    speed_m_s: Positive
    """Largest leg speed; more faults."""
    acceleration_m_s2: Positive | None = None
    """Largest leg acceleration of the reference, checked before the run. Default: no limit."""
    deceleration_m_s2: Positive
    """Deceleration a of the square-root speed cap before the soft ends: |dq| <= sqrt(2 a distance)."""
    stroke_margin_m: NonNegative = 0.0
    """Distance of the soft ends inside length_min_m and length_max_m."""
    following_error_m: Positive
    """Largest leg error at rest; more faults."""
    following_error_s: NonNegative = 0.0
    """Additional leg error per m/s of reference leg rate."""
    standstill_m: Positive = 5e-4
    """Largest movement of a leg on its closed brake; more faults. Set above brake give and encoder error."""
    consistency_m: Positive = 1e-4
    """Largest residual of forward kinematics; more faults."""
    condition: Positive = 50.0
    """Largest condition number of J (lengths made comparable); more faults."""
    stale_warn_ticks: Ticks = 1
    stale_fault_ticks: Ticks = 5
    sync_skew_us: Positive | None = None
    """Several buses: SYNCs farther apart than this make a tick late. Default: a tenth of the period."""
    missed_stop_ticks: Ticks = 5
    """Consecutive missed periods that trigger a controlled stop."""
    stretch_percent: Annotated[float, Field(ge=0, le=100)] = 5.0
    """Share of the run for which the clock of a virtual bench may stand still in stalls of 4 ms and more,
    plus half a second: more triggers a controlled stop. See `loop.on_stall`."""

    @model_validator(mode="after")
    def _warn_before_fault(self) -> Self:
        if self.stale_warn_ticks > self.stale_fault_ticks:
            allowed = f"allowed: at most {self.stale_fault_ticks}, given: {self.stale_warn_ticks}"
            raise ValueError(f"stale_warn_ticks is above stale_fault_ticks, {allowed}")
        return self


class MonitorSettings(Section):
    """Monitor of the tracking error: reaction if the error grows faster than its Lyapunov function allows."""

    action: Literal["log", "warn", "fault"] = "log"
    """`log`: record V, its rate and its bound. `warn`: also warn (CERTIFICATE). `fault`: end the run."""
    disturbance_m_s2: Positive = 8.0
    """Acceleration of a leg, or of the platform along an axis, that raises no alarm: loads, friction and
    anything else outside the law's model. 10 kN on the book's platform cause up to 7.9 in a leg."""
    disturbance_rad_s2: Positive = 8.0
    """Angular acceleration of the platform about an axis that raises no alarm, for laws in pose space."""
    confirm_ticks: Annotated[int, Field(ge=1)] = 3
    """Consecutive ticks with a violation that raise the alarm."""
    length_noise_m: NonNegative = 2e-6
    """Largest error of a measured length: the encoder's resolution, or 3 to 4 standard deviations of its
    noise."""
    rate_noise_m_s: NonNegative = 1e-4
    """Largest error of a measured leg rate, chosen as for the length."""
    rate_skew_us: NonNegative = 50.0
    """Largest time difference between a leg's length and its rate, from sampling, filtering or computing."""
    rate_error_percent: NonNegative = 1.0
    """Largest scale error of a leg rate."""
    friction_N: NonNegative | None = None
    """Dry friction that may hold a leg at rest. Default: the largest of the law's model and the virtual
    plant; without a plant, or with a custom FMU, at least 5 % of the smallest of limits.force_N,
    limits.force_window_N and drives.force_limit_N."""
    drive_lag_ms: Delay = 0.8
    """Time constant of the drives' force loop: 1000 / (2 pi bandwidth in Hz)."""


Stop = Literal["ss1", "sbc", "sto"]
"""ss1: controlled stop along the path within `engage.stop_s`, then as sbc. sbc: brakes at once; the force
stays on until they are proven shut. sto: no force, and the brakes at once, unproven."""
Brake = Literal["sbc", "sto"]


class ReactionSettings(Section):
    """Reaction to each fault while the brakes are open, according to what is still known.

    The words are those of IEC 61800-5-2: safe stop 1, safe brake control, safe torque off. After the first
    two, a platform whose brakes are not proven keeps its force where there is any. `sto` removes the force at
    once, in every mode. Of several faults the strongest reaction counts. An emergency stop, a bus that is
    down, another controller, and silence of all drives always lead to `sto`: no drive could obey.
    """

    stale: Brake = "sbc"
    """The feedback of a leg is missing."""
    drive: Brake = "sbc"
    """One drive has failed; the others hold."""
    stroke: Stop = "sbc"
    speed: Stop = "sbc"
    following: Stop = "sbc"
    """The legs do not follow the reference, so a stop along it is unreliable."""
    kinematics: Brake = "sbc"
    assembly: Brake = "sbc"
    condition: Stop = "sbc"
    not_finite: Brake = "sbc"
    law: Brake = "sbc"
    encoder: Brake = "sbc"
    """An encoder is not trusted any more."""
    uncertain: Brake = "sbc"
    certificate: Stop = "ss1"
    duplicate_node: Brake = "sbc"
    refused_frames: Stop = "ss1"
    set_up: Stop = "ss1"
    silence: Literal["brake", "damp", "hold", "zero"] = "brake"
    """Reaction of a drive that receives no command during motion. `brake`: close the brake and keep the last
    force until it has closed. `damp`: act against its speed, `hold`: keep its place, then brake, see
    `drives.brake_after_ms`. `zero`: no force and no brake. An emergency stop always brakes."""

    def led_to(self, reaction: str) -> Fault:
        """Bits of all faults for which these settings choose `reaction`, for example "sbc"."""
        faults = Fault.NONE
        for name in Fault.__members__:
            if getattr(self, name.lower(), "") == reaction:
                faults |= Fault[name]
        return faults
