"""What `hil check` warns of: configurations that run, and that nobody should stand under."""

from collections.abc import Iterator

import numpy as np

from drivers.motors import MotorProtocol
from drivers.signals import Fault
from drivers.transmission import Transmission
from hil.app.check.brakes import brake_dangers
from hil.app.check.silence import Silence
from hil.app.compose import build_protocol
from hil.app.configuration.configuration import Configuration
from hil.app.encoder_limits import encoder_limits
from hil.app.force_steps import force_steps_N, stepped_error_m
from hil.app.reachability import Walk
from hil.safety.residuals import SUSPECT, gap_bound

UNSTATED = 3.0
"""A rated force that nobody stated and that is this many times above the limit is a mistake."""
JUMP_SHARE = 0.1
"""A jump of a larger share of the stroke has to be seen."""
FEWEST_TURNS = 0.1
"""Of a motor, in which it carries a leg over its whole stroke."""
FASTEST_1_s = 500.0
"""Turns a second of a motor."""
STRONGEST_N_m = 1000.0
"""Torque of a motor."""


def dangers(c: Configuration, w: Walk, silence: Silence | None) -> Iterator[str]:
    """Yield what is dangerous; silence is None where nothing ends it.

    The layout ideal drives no hardware, so nothing is dangerous with it.
    """
    if c.bus.layout == "ideal":
        return
    weight_N = float(np.abs(w.rest).max())
    if c.reactions.silence == "zero":
        yield (
            "reactions.silence zero: after silence nothing holds the platform, whose legs carry "
            f"up to {weight_N:.0f} N; write brake"
        )
    sto = [name.lower() for name, fault in Fault.__members__.items() if fault & c.reactions.led_to("sto")]
    if sto:
        yield (
            f"reactions sto after {', '.join(sto)}: the platform falls until the brakes act, and whether "
            "they hold is not tested; sbc keeps the force on until they are proven"
        )
    if c.engage.force_ramp_s <= 0.0:
        yield "engage.force_ramp_s 0: no brake is ever tested, neither at the start nor when parking"
    hit = silence and silence.beyond(w, c.platform.length_min_m, c.platform.length_max_m)
    if c.reactions.silence == "brake" and hit is not None:
        yield (
            f"drives.watchdog_ms {c.drives.watchdog_ms:g} and engage.brake_close_s "
            f"{c.engage.closing_s:g}: after silence at t = {hit.t:.3f} s leg {hit.leg} travels up to "
            f"{1e3 * hit.travel_m:.0f} mm until it rests on its brake, and is {1e3 * hit.free_m:.0f} mm from "
            "a hard end; shorten drives.watchdog_ms, engage.brake_close_s to what the brakes take, or speed "
            "or stroke of the reference"
        )
    protocol = build_protocol(c)
    yield from protocol.traits.dangers
    if isinstance(protocol, MotorProtocol) and c.drives.homing is None:
        yield (
            "drives.homing: left out, so after a power-off each drive has to know by itself how often its "
            "motor has turned; one that does not reads a length that is wrong by whole turns, and nothing "
            "compares it with where the legs were parked"
        )
    yield from _implausible(c)
    yield from _blind(c)
    yield from _coarse(c)
    yield from brake_dangers(c, w)
    rated, asked = c.drives.force_limit_N, c.limits.force_N
    if "force_limit_N" not in c.drives.model_fields_set and rated > UNSTATED * asked:
        yield (
            f"drives.force_limit_N is not stated, and {rated:.0f} N are assumed as the drives' rated force, "
            f"{rated / asked:.0f} times limits.force_N {asked:g}: state that of your drives"
        )


def _implausible(c: Configuration) -> Iterator[str]:
    """Yield what makes of the stated transmission a motor that there is hardly any of."""
    if c.drives.transmission is None:
        return
    gear, s = Transmission(c.drives.transmission), c.platform
    stroke = float(((s.length_max_m - s.length_min_m) / np.abs(gear.m_per_turn)).min())
    speed = float((c.limits.speed_m_s / np.abs(gear.m_per_turn)).max())
    torque = float((c.limits.force_N / np.abs(gear.N_per_Nm)).max())
    key = "drives.transmission: lead_m, pulley_radius_m or gear_ratio"
    if stroke < FEWEST_TURNS:
        yield (
            f"{key}: the whole stroke is {stroke:.3g} turns of the motor, fewer than {FEWEST_TURNS:g}: state "
            "the leg length of a turn in m"
        )
    if speed > FASTEST_1_s:
        yield (
            f"{key}: limits.speed_m_s {c.limits.speed_m_s:g} is {60.0 * speed:.3g} rpm of the motor, more "
            f"than {60.0 * FASTEST_1_s:g}: state the leg length of a turn in m"
        )
    if torque > STRONGEST_N_m:
        yield (
            f"{key}: limits.force_N {c.limits.force_N:g} needs {torque:.3g} N m of the motor, more than "
            f"{STRONGEST_N_m:g}: state the leg length of a turn in m"
        )


def _blind(c: Configuration) -> Iterator[str]:
    """Yield the rules on encoders that the stated noise leaves without effect."""
    limits = encoder_limits(c, c.loop.rate_Hz)
    noise_m, T, following_m = limits.length_noise_m, limits.period_s, c.limits.following_error_m
    jump_m = gap_bound(noise_m, limits.rate_noise_m_s, 2.0 * limits.disturbance_m_s2, T)
    most_m = JUMP_SHARE * (c.platform.length_max_m - c.platform.length_min_m)
    stated = f"monitor.length_noise_m {c.monitor.length_noise_m:g}"
    mend = "give the largest deviation of a reading, 3 to 4 standard deviations"
    if jump_m > most_m:
        yield (
            f"{stated}: a jump is seen from {1e3 * jump_m:.3g} mm on, more than a tenth of the stroke "
            f"({1e3 * most_m:.3g} mm), so the rules on jumps are without effect; {mend}"
        )
    if SUSPECT * noise_m > following_m:
        yield (
            f"{stated}: a leg that stands still is suspected from {1e3 * SUSPECT * noise_m:.3g} mm on, above "
            f"limits.following_error_m {following_m:g}, so that rule is without effect; {mend}"
        )


def _coarse(c: Configuration) -> Iterator[str]:
    """Yield steps of the force that alone may take a leg beyond its following error."""
    error_m, allowed_m = stepped_error_m(c), c.limits.following_error_m
    if error_m is not None and error_m > allowed_m:
        yield (
            f"limits.following_error_m {allowed_m:g}: one code of torque is {force_steps_N(c).max():.2g} N "
            f"at the leg, which alone may leave it {1e3 * error_m:.3g} mm from its reference; raise the "
            "travel a turn (drives.transmission), take a weaker model, or raise controller.wn_rad_s"
        )
