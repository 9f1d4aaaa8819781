"""From a configuration to the limits of the rules on encoders, and to leg errors for the fused pose."""

from math import ceil, hypot, inf, sqrt
from typing import NamedTuple

import numpy as np

from drivers import build_protocol
from drivers.arrays import Array
from drivers.errors import ConfigurationError
from drivers.signals import LEGS
from drivers.transmission import Transmission
from hil.app.configuration.configuration import Configuration
from hil.app.loop_delay import loop_delay
from hil.app.unknown_payload import unknown_payload
from hil.estimation.fusion_layout import LegErrors
from hil.safety.encoder_kernels import RATE_MOVES
from hil.safety.encoder_limits import UNASKED, UNSHARED, EncoderLimits
from hil.safety.residuals import MOVED
from plant_fmu.config import BenchPlant, StewartPlant

LENGTH_STEP_M = 1e-7
"""Least step of a length that counts."""
AWAY = 2.0
"""Mobility at home times this bounds it elsewhere, the error of the model included."""
ASSUMED_FRICTION = 0.05
"""Share of the largest force of a leg that friction may take where nobody states it."""
PUSH = {False: 0.038, True: 0.25}
"""Share of the stated disturbance that a leg is pushed by, by whether it sticks: nobody feels a slow rise."""
PUSHED_SPEED = 0.8
"""Share of the largest leg speed that legs may reach which come free under their pushes."""
LONGEST_RISE_S = 0.2
"""No push rises more slowly: the law changes meanwhile."""
NEVER_TICKS = 1e12
"""30 years at 1 kHz: what takes longer is never seen."""
LAGS = 3.0
"""Time constants of the drives' force loop after which a force acts in full, but for 5 % of it."""
REACHES_BACK = 2
"""Periods from a rate that is a slope of lengths to the first length that it is made of."""
NOISE = sqrt(12.0)
"""Largest deviation by standard deviation: a step, or 3 to 4 standard deviations of white noise."""
UNKNOWN = sqrt(3.0)
"""The same of a constant that may be anything from the bound to its negative."""


def encoder_limits(c: Configuration, rate_Hz: float) -> EncoderLimits:
    """Return what the rules on encoders compare with at a rate of the loop.

    A push takes a leg that bears F N from one end of what friction and losses balance, (F - friction) eta_b,
    to beyond the other, (F + friction + what accelerates it) / eta_d. Where the pose is fused with a tracker,
    the filter decides: no encoder is watched here. Raises ConfigurationError where the legs are singular.
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
        raise ConfigurationError("platform: no leg forces hold it at home: the legs are singular there")
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
        unshared=UNASKED if protocol.traits.unasked_s > 0.0 else UNSHARED,
        friction_N=stated_friction_N(c),
        driving=driving,
        back_driving=back_driving,
        mobility_low=low,
    )


def _ticks(number: float) -> int:
    return ceil(min(number, NEVER_TICKS))


def _rise_ticks(
    push_N: Array, A: Array, late_s: float, rate_noise_m_s: float, speed_m_s: float, period_s: float
) -> int:
    """Return within how many ticks a push may rise, so that legs that come free are seen in time; 1: at once.

    At once is best, as a leg that does not move is found the sooner: a leg may gain v = S F late_s, S the
    largest sum of a row of A (6, 6) 1/kg, F the push on all legs, if v is within a share of the largest
    speed. Else at r N/s one of them gains v = S r t^2 / 2. That is seen beyond the noise v_0 of a rate, and
    late_s later the push goes: sqrt(v) = sqrt(v_0) + late_s sqrt(S r / 2), v that share.
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
    """Largest deviation of what is read of a leg."""

    length_m: float
    rate_m_s: float


def steps(c: Configuration, rate_Hz: float) -> Noise:
    """Return what the steps leave of a reading, of an emulated encoder and of the drives' frames."""
    encoder_m = 0.0 if c.plant is None else c.plant.drives.encoder_resolution_m
    read = build_protocol(c.bus, c.drives).traits.resolution.at(rate_Hz)
    return Noise(encoder_m + max(float(read.length.max()), LENGTH_STEP_M), float(read.rate.max()))


def read_noise(c: Configuration, rate_Hz: float) -> Noise:
    """Return what a reading may be off: as section monitor states, and no less than the steps leave."""
    least = steps(c, rate_Hz)
    return Noise(max(c.monitor.length_noise_m, least.length_m), max(c.monitor.rate_noise_m_s, least.rate_m_s))


def efficiencies(c: Configuration) -> tuple[Array, Array]:
    """Return what is left of a force (6,) where the motor drives the leg, and where the leg drives it."""
    if c.drives.transmission is None:
        return np.ones(LEGS), np.ones(LEGS)
    gear = Transmission(c.drives.transmission)
    return gear.driving, gear.back_driving


def believed_mass_kg(c: Configuration) -> Array:
    """Mass that motor and screw add along each leg as the controller believes, (6,) kg."""
    believed = c.controller.believed
    return np.broadcast_to(0.0 if believed is None else np.array(believed.reflected_mass_kg, float), LEGS)


def stated_friction_N(c: Configuration) -> float:
    """Dry friction that is configured or identified, N."""
    if c.monitor.friction_N is not None:
        return c.monitor.friction_N
    believed = c.controller.believed
    known = 0.0 if believed is None else float(np.max(believed.coulomb_friction_N))
    if c.plant is not None and isinstance(c.plant.model, StewartPlant):
        return max(known, c.plant.model.coulomb_friction_N)
    return known


def friction_N(c: Configuration) -> float:
    """Dry friction that may hold a leg still, N: stated, or assumed where nobody knows."""
    stated = stated_friction_N(c)
    emulated = c.plant is not None and isinstance(c.plant.model, StewartPlant | BenchPlant)
    if emulated or c.monitor.friction_N is not None:
        return stated
    return max(
        stated, ASSUMED_FRICTION * min(c.limits.force_N, c.limits.force_window_N, c.drives.force_limit_N)
    )


def leg_errors(c: Configuration) -> LegErrors:
    """Return the errors of the legs as the sections estimation, monitor and plant state them."""
    s, monitor = c.estimation.fusion, c.monitor
    length_std_m, rate_std_m_s, force_std_N = s.length_std_m, s.rate_std_m_s, s.leg_force_std_N
    if length_std_m is None:
        length_std_m = read_noise(c, c.loop.rate_Hz).length_m / NOISE
        if c.plant is not None:  # from the steps in which it comes
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
    )
