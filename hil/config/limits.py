"""Sections `limits`, `monitor` and `reactions`: what safety refuses, and what is done about it."""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from drivers.section import Section
from drivers.signals import Fault
from hil.config.delay import Delay
from hil.config.values import NonNegative, Positive

Ticks = Annotated[int, Field(ge=1, le=1000)]


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
    """A leg that moves farther on its closed brake faults. More than brakes give way and encoders err."""
    consistency_m: Positive = 1e-4
    """Residual of forward kinematics that faults."""
    condition: Positive = 50.0
    """Condition number of J (lengths made comparable) that faults."""
    stale_warn_ticks: Ticks = 2
    stale_fault_ticks: Ticks = 5
    sync_skew_us: Positive | None = None
    """Several buses: SYNCs farther apart than this make a tick late. Default: a tenth of the period."""
    missed_stop_ticks: Ticks = 5
    """Periods missed in a row that ask for a controlled stop."""
    stretch_percent: Annotated[float, Field(ge=0, le=100)] = 5.0
    """Share of the run for which the time of a virtual bench may stand still in stretches of 4 ms and more,
    beside half a second: more asks for a controlled stop. See `loop.on_stall`."""

    @model_validator(mode="after")
    def _warn_before_fault(self) -> Self:
        if self.stale_warn_ticks > self.stale_fault_ticks:
            allowed = f"allowed: at most {self.stale_fault_ticks}, given: {self.stale_warn_ticks}"
            raise ValueError(f"stale_warn_ticks is above stale_fault_ticks, {allowed}")
        return self


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
    """Largest deviation of a read length: the encoder's step, or 3 to 4 standard deviations of its noise."""
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


Stop = Literal["ss1", "sbc", "sto"]
"""ss1: a stop under control, along the path, within `engage.stop_s`; then as sbc. sbc: the brakes at once,
and the force stays on until they are proven shut. sto: no force and the brakes, at once, unproven."""
Brake = Literal["sbc", "sto"]


class ReactionSettings(Section):
    """What is done about each fault that strikes while the brakes are open, by what is still known.

    The words are those of IEC 61800-5-2: safe stop 1, safe brake control, safe torque off. After the first
    two a platform whose brakes are not proven shut keeps its force where there is any; `sto` takes it off at
    once, in every mode. Of several faults the strongest reaction counts. An emergency stop, a bus that is
    down, another controller, and drives that none of them is heard of any more, are always `sto`: there is
    nobody who could obey.
    """

    stale: Brake = "sbc"
    """A leg is not heard."""
    drive: Brake = "sbc"
    """One drive has failed; the others hold."""
    stroke: Stop = "sbc"
    speed: Stop = "sbc"
    following: Stop = "sbc"
    """The legs do not follow the reference: a stop along it cannot be relied on."""
    kinematics: Brake = "sbc"
    assembly: Brake = "sbc"
    condition: Stop = "sbc"
    not_finite: Brake = "sbc"
    law: Brake = "sbc"
    encoder: Brake = "sbc"
    """An encoder is not believed."""
    uncertain: Brake = "sbc"
    certificate: Stop = "ss1"
    duplicate_node: Brake = "sbc"
    refused_frames: Stop = "ss1"
    set_up: Stop = "ss1"
    silence: Literal["brake", "damp", "hold", "zero"] = "brake"
    """What a drive does by itself when it hears no command in motion. `brake`: its brake, and its last force
    until that has closed; `damp`, `hold`: against its speed, or in its place, then its brake, see
    `drives.brake_after_ms`; `zero`: no force and no brake. An emergency stop always brakes."""

    def led_to(self, reaction: str) -> Fault:
        """Return the faults that lead to a reaction."""
        faults = Fault.NONE
        for name in Fault.__members__:
            if getattr(self, name.lower(), "") == reaction:
                faults |= Fault[name]
        return faults
