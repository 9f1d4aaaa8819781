"""The part of `hil check` that says what is seen of an encoder that fails, and what is not."""

import numpy as np

from hil.app.check.findings import Report
from hil.app.configuration.configuration import Configuration
from hil.app.encoder_limits import encoder_limits, friction_N, steps
from hil.safety.residuals import (
    SHOWS_AS_GAP,
    SHOWS_AS_LEAP,
    SUSPECT,
    WINDOW_S,
    acceleration_range,
    gap_bound,
    lag_of,
    lag_of_leap,
    leap_bound,
    slip_bound,
)

NOT_OBSERVABLE = "not observable with these sensors"


def report_encoders(report: Report, c: Configuration) -> None:
    """Print the limits of the rules on encoders, and what each fault leaves which they cannot see.

    The limits hold at rest and without a change of force; motion and force widen them.
    """
    limits = encoder_limits(c, c.loop.rate_Hz)
    T, noise_m = 1.0 / c.loop.rate_Hz, limits.length_noise_m
    still = np.zeros(6)
    a = max(acceleration_range(limits.mobility, still, limits.disturbance_m_s2, leg) for leg in range(6))
    rate_noise = limits.rate_noise_m_s + limits.rate_skew_s * a
    jump_m = gap_bound(noise_m, rate_noise, a, T)
    slip_m = slip_bound(noise_m, rate_noise, a, T, limits.rate_error, 0.0)
    leap_m_s = leap_bound(rate_noise, a, T, T)
    if limits.differences:
        lag_s = lag_of(T, T)
        jump_m += T * lag_s * a
        leap_m_s += lag_of_leap(lag_s, lag_s, T, T) * a
        jump_m = min(jump_m / SHOWS_AS_GAP, leap_m_s * T / SHOWS_AS_LEAP)
    strayed_m, tested_s = SUSPECT * noise_m, limits.push_ticks * T
    drift_m_s, late_m = slip_m / WINDOW_S, c.limits.speed_m_s * T
    beside = "that makes the rate leap" if limits.differences else "beside the rate"
    then, ways = ("beyond known friction", "one way") if limits.sticks else ("then", "each way")
    push = f"a push of up to {limits.push_N.max():.0f} N"
    within = f"{1e3 * WINDOW_S:g} ms"
    stays = f"within {1e6 * noise_m:g} um while a leg strays by {1e3 * strayed_m:g} mm"
    share = limits.rate_error + limits.unshared * T / WINDOW_S
    scale = f"{1e2 * share:.3g} %"
    braked_mm = 1e3 * c.limits.standstill_m
    lines = [
        f"jump        {1e3 * jump_m:.3f} mm from one reading to the next {beside}",
        f"slip        {1e3 * slip_m:.3f} mm and {scale} of the way in {within}",
        f"rate        {leap_m_s:.3f} m/s of one leg in a tick, which force and disturbance do not explain",
        f"standstill  {stays}; {then} {push},",
        f"            more than {friction_N(c):g} N of friction, {1e3 * tested_s:.0f} ms {ways}",
        f"drift       as of the rate: {NOT_OBSERVABLE} in motion, at any",
        f"            speed; leaves speed x time. On closed brakes BRAKE beyond {braked_mm:g} mm",
        f"scale       as of the rate: {NOT_OBSERVABLE} at any size;",
        "            leaves share x travel",
        f"either      of length or rate alone: found beyond {1e3 * drift_m_s:.2f} mm/s and {scale} of the",
        f"            leg's speed; a step of the rate beyond {leap_m_s:.3f} m/s is a leap",
        f"a tick late {NOT_OBSERVABLE}; leaves {1e3 * late_m:.2f} mm at limits.speed_m_s",
        f"frozen      at true rest: {NOT_OBSERVABLE}; leaves nothing until a leg strays",
    ]
    lines = [*_steps(c), *lines]
    if not limits.watched_legs:
        lines = ["the filter of the fused pose decides, with the tracker: see encoder_slip_m"]
    report.sections["encoders, at rest"] = lines
    report.figures["encoders"] = {
        "jump_m": jump_m,
        "slip_m": slip_m,
        "leap_m_s": leap_m_s,
        "standstill_m": noise_m,
        "strayed_m": strayed_m,
        "push_N": limits.push_N.tolist(),
        "push_s": tested_s,
        "drift_of_length_alone_m_s": drift_m_s,
        "scale_of_rate_alone": share,
        "not_observable": {"late_m": late_m, "frozen_m": strayed_m},
    }


def _steps(c: Configuration) -> list[str]:
    """Say where the steps of drives and encoders are coarser than what is stated of their noise."""
    least, monitor = steps(c, c.loop.rate_Hz), c.monitor
    found = []
    for what, key, stated, step, scale, unit in (
        ("lengths", "length_noise_m", monitor.length_noise_m, least.length_m, 1e6, "um"),
        ("rates", "rate_noise_m_s", monitor.rate_noise_m_s, least.rate_m_s, 1e3, "mm/s"),
    ):
        if step > stated:
            found.append(
                f"steps       of {what}: {scale * step:.3g} {unit} count, monitor.{key} states "
                f"{scale * stated:.3g} {unit}"
            )
    return found
