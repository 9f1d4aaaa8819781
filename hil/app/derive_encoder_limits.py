"""Derives the limits of the encoder checks, and leg errors for sensor fusion, from a configuration."""

from math import ceil, hypot, inf, radians, sqrt
from typing import Any, NamedTuple

import numpy as np

from drivers import build_protocol
from drivers.arrays import Array
from drivers.errors import ConfigurationError
from drivers.sensors import SIGMAS
from drivers.signals import LEGS
from drivers.transmission import Transmission
from hil.app.configuration.configuration import Configuration
from hil.app.configuration.platform import build_platform
from hil.app.loop_delay import loop_delay
from hil.app.unknown_payload import unknown_payload
from hil.estimation.fusion_layout import LegErrors
from hil.estimation.sensor_check import SAMPLES
from hil.safety.encoder_limits import UNASKED, UNSHARED, EncoderLimits
from hil.safety.encoder_rules import RATE_MOVES
from hil.safety.residuals import MOVED
from hil.safety.second_encoders import STOPS, WARNS
from plant_fmu.config import BenchPlant, StewartPlant

LENGTH_STEP_M = 1e-7
"""Smallest resolution of a length."""
AWAY = 2.0
"""Bound on the ratio of mobility in the workspace to mobility at home, model error included."""
ASSUMED_FRICTION = 0.05
"""Assumed friction of a leg, as a share of its largest force, where none is configured."""
PUSH = {False: 0.038, True: 0.25}
"""Probe push as a share of the stated disturbance, by whether the leg sticks: then it is a slow ramp."""
PUSHED_SPEED = 0.8
"""Share of the largest leg speed that a leg may reach when it breaks free under its probe push."""
LONGEST_RISE_S = 0.2
"""Longest rise of a probe push: after that the law's force has changed."""
NEVER_TICKS = 1e12
"""30 years at 1 kHz: an upper bound for detection times."""
LAGS = 3.0
"""Settling time of the drives' force loop to 5 %, in time constants."""
REACHES_BACK = 2
"""Periods between a rate computed as a difference of lengths and the first length that it uses."""
NOISE = sqrt(12.0)
"""Ratio of largest to standard deviation: of a quantisation step, or 3 to 4 sigma of white noise."""
UNDECIDED_S, BY_TRACKER_S = 0.1, 2.0
"""Time, s, until a contradiction of two encoders counts; and if a tracker may show which one is wrong."""
UNKNOWN = sqrt(3.0)
"""Ratio of largest to standard deviation of a constant, uniform within +- its bound."""


def encoder_limits(c: Configuration, rate_Hz: float) -> EncoderLimits:
    """Limits of the safety rules that check the encoders, at a rate of the loop.

    A probe push tests a resting encoder. It takes a leg with load F, N, across its whole friction band: from
    (F - friction) eta_b to (F + friction + force to accelerate it) / eta_d. With a tracker in the fused pose,
    the filter checks the encoders instead. Raises ConfigurationError if the legs are singular at home.
    """
    payload, period_s = unknown_payload(c), 1.0 / rate_Hz
    friction, protocol = friction_N(c), build_protocol(c.bus, c.drives)
    monitor, A = payload.allowed(c.monitor), np.abs(payload.mobility).max(axis=0)
    yields = unknown_payload(c, believed_mass_kg(c)).mobility
    low = np.diag(yields.min(axis=0))
    decided = c.estimation.pose == "fused" and c.sensors.tracker is not None
    delay = loop_delay(c)
    noise = read_noise(c, rate_Hz)
    noise_m, differences = noise.length_m, int(protocol.traits.resolution.differences)
    driving, back_driving = efficiencies(c)
    sticks = friction > 0.0 or bool((driving * back_driving < 1.0).any())
    push = PUSH[sticks] * monitor.disturbance_m_s2
    up_N = (payload.holding_N + friction + push / low) / driving
    push_N = up_N - (payload.holding_N - friction) * back_driving
    if not np.isfinite(push_N).all():
        raise ConfigurationError("platform: no leg forces can hold it at home: the legs are singular there")
    seen_s = sqrt((2.0 if sticks else 24 / 7) * MOVED * noise_m / push)  # x = a t^2 / 2, or 7/24 a t^2
    late_s = delay.transport_s * c.loop.rate_Hz * period_s + period_s + 2.0 * delay.lag_s
    rise = (
        _rise_ticks(push_N, np.abs(yields).max(axis=0), late_s, noise.rate_m_s, c.limits.speed_m_s, period_s)
        if sticks
        else 1
    )
    ticks = _ticks((late_s + seen_s) / period_s)
    turns = _ticks((1.0 if sticks else 2.0) * float(push_N.max()) / c.limits.force_step_N)
    return EncoderLimits(
        watched_legs=0 if decided else (1 << LEGS) - 1,
        length_noise_m=noise_m,
        rate_noise_m_s=noise.rate_m_s,
        rate_skew_s=1e-6 * monitor.rate_skew_us,
        rate_error=1e-2 * monitor.rate_error_percent,
        disturbance_m_s2=monitor.disturbance_m_s2,
        mobility=AWAY * A,
        acting_ticks=ceil((late_s + LAGS * delay.lag_s) / period_s) + REACHES_BACK * differences,
        push_N=push_N,
        push_ticks=ticks + max(turns - 1, 0) + rise - 1 if sticks else max(ticks, turns),
        sticks=int(sticks),
        rise_ticks=rise,
        open_ticks=ceil(c.engage.brake_release_s / period_s),
        period_s=period_s,
        unnamed=int(not protocol.traits.answers_name_sync),
        differences=differences,
        apart=int(not protocol.traits.latches_together),
        unshared=protocol.traits.stray(UNASKED, UNSHARED, c.loop.rate_Hz),
        friction_N=stated_friction_N(c),
        driving=driving,
        back_driving=back_driving,
        mobility_low=low,
        **_second(c, rate_Hz),
    )


def _second(c: Configuration, rate_Hz: float) -> dict[str, Any]:
    """Limits of the rules on second encoders."""
    lengths, tracker = c.sensors.lengths, c.sensors.tracker
    if lengths is None:
        return {}
    found: dict[str, Any] = {
        "second": STOPS if lengths.on_contradiction == "stop" else WARNS,
        "second_m": SIGMAS * lengths.std_m,
        "second_late_s": SIGMAS * 1e-3 * lengths.time_std_ms,
        "second_ticks": ceil(UNDECIDED_S * rate_Hz),
    }
    if tracker is not None:
        radius = build_platform(c.platform).radius
        std_m = hypot(tracker.position_std_m, radius * radians(tracker.orientation_std_deg))
        found["tracker_s"] = SAMPLES / tracker.rate_Hz
        found["tracker_ticks"] = ceil(BY_TRACKER_S * rate_Hz)
        found["tracker_std_m"] = std_m / sqrt(2.0 * SAMPLES - 1.0)
    return found


def _ticks(number: float) -> int:
    return ceil(min(number, NEVER_TICKS))


def _rise_ticks(
    push_N: Array, A: Array, late_s: float, rate_noise_m_s: float, speed_m_s: float, period_s: float
) -> int:
    """Rise time of a probe push in ticks, so that legs that break free are noticed in time; 1: a step.

    A step is preferred, as it finds a stuck leg sooner. In late_s a free leg gains v = S F late_s, where S is
    the largest row sum of A (6, 6) 1/kg and F the push on all legs. The step is allowed while v is at most a
    share of the largest speed. Otherwise the push is a ramp of r N/s, under which v = S r t^2 / 2 is that
    share. The motion is seen above the rate noise v_0, and the push ends late_s later: sqrt(v) = sqrt(v_0) +
    late_s sqrt(S r / 2).
    """
    S, most = float(A.sum(axis=1).max()), PUSHED_SPEED * speed_m_s
    if S * float(push_N.max()) * late_s <= most:
        return 1
    spare = sqrt(most) - sqrt(RATE_MOVES * rate_noise_m_s)
    r = 2.0 * (max(spare, 0.0) / late_s) ** 2 / S
    longest = ceil(LONGEST_RISE_S / period_s)
    needed = float(push_N.max()) / (r * period_s) if r > 0.0 else inf
    return ceil(needed) if needed < longest else longest


class Noise(NamedTuple):
    """Largest deviations of a leg's length and rate readings from the true values."""

    length_m: float
    rate_m_s: float


def steps(c: Configuration, rate_Hz: float) -> Noise:
    """Quantisation of length and rate readings, by an emulated encoder and by the drives' frames."""
    encoder_m = 0.0 if c.plant is None else c.plant.drives.encoder_resolution_m
    read = build_protocol(c.bus, c.drives).traits.resolution.at(rate_Hz)
    return Noise(encoder_m + max(float(read.length.max()), LENGTH_STEP_M), float(read.rate.max()))


def read_noise(c: Configuration, rate_Hz: float) -> Noise:
    """Largest deviation of readings: as stated in section `monitor`, and at least the quantisation."""
    least = steps(c, rate_Hz)
    return Noise(max(c.monitor.length_noise_m, least.length_m), max(c.monitor.rate_noise_m_s, least.rate_m_s))


def efficiencies(c: Configuration) -> tuple[Array, Array]:
    """Efficiencies (6,), 0 to 1: of the motor driving the leg, and of the leg driving the motor."""
    if c.drives.transmission is None:
        return np.ones(LEGS), np.ones(LEGS)
    gear = Transmission(c.drives.transmission)
    return gear.driving, gear.back_driving


def believed_mass_kg(c: Configuration) -> Array:
    """Reflected mass (6,) kg of motor and screw along each leg in the controller's model."""
    believed = c.controller.believed
    return np.broadcast_to(0.0 if believed is None else np.array(believed.reflected_mass_kg, float), LEGS)


def stated_friction_N(c: Configuration) -> float:
    """Dry friction of a leg, N, as configured in section `monitor`, the law's model or the plant."""
    if c.monitor.friction_N is not None:
        return c.monitor.friction_N
    believed = c.controller.believed
    known = 0.0 if believed is None else float(np.max(believed.coulomb_friction_N))
    if c.plant is not None and isinstance(c.plant.model, StewartPlant):
        return max(known, c.plant.model.coulomb_friction_N)
    return known


def friction_N(c: Configuration) -> float:
    """Dry friction that may hold a leg still, N: as stated, or an assumed share of the largest force."""
    stated = stated_friction_N(c)
    emulated = c.plant is not None and isinstance(c.plant.model, StewartPlant | BenchPlant)
    if emulated or c.monitor.friction_N is not None:
        return stated
    return max(
        stated, ASSUMED_FRICTION * min(c.limits.force_N, c.limits.force_window_N, c.drives.force_limit_N)
    )


def leg_errors(c: Configuration) -> LegErrors:
    """Standard deviations of leg readings and forces, from sections `estimation`, `monitor` and `plant`."""
    s, monitor = c.estimation.fusion, c.monitor
    length_std_m, rate_std_m_s, force_std_N = s.length_std_m, s.rate_std_m_s, s.leg_force_std_N
    if length_std_m is None:
        length_std_m = read_noise(c, c.loop.rate_Hz).length_m / NOISE
        if c.plant is not None:  # quantisation noise
            encoder_m = c.plant.drives.encoder_resolution_m
            length_std_m = hypot(encoder_m, steps(c, c.loop.rate_Hz).length_m - encoder_m) / NOISE
    if rate_std_m_s is None:
        rate_std_m_s = read_noise(c, c.loop.rate_Hz).rate_m_s / NOISE
    if force_std_N is None:
        force_std_N = max(0.0, friction_N(c) - float(np.min(s.model.coulomb_friction_N)))
    return LegErrors(
        length_std_m,
        rate_std_m_s,
        rate_skew_std_s=1e-6 * monitor.rate_skew_us / UNKNOWN,
        rate_scale_std=1e-2 * monitor.rate_error_percent / UNKNOWN,
        force_std_N=force_std_N,
        force_time_s=1e-3 * s.leg_force_time_ms,
        reports_force=build_protocol(c.bus, c.drives).traits.reports_force,
    )
