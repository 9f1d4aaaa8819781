"""Figures that `hil check` prints about the stability monitor, the encoders and the fused pose."""

import numpy as np

from hil.app.check.report import Report
from hil.app.derive_encoder_limits import friction_N, leg_errors, steps
from hil.design.stability.monitor import certified
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
from plant_fmu.config import FmuPlant


def monitor(r: Report) -> None:
    """Add whether the law has a Lyapunov certificate, and the reaction to its violation, to the report."""
    s = r.s
    dynamics, action = certified(s.c.controller), s.c.monitor.action
    r.figures["monitor"] = {"watched": not isinstance(dynamics, str), "action": action}
    if isinstance(dynamics, str):
        r.add("controller", "not monitored: {reason}", reason=dynamics)
        return
    allowed = (s.unknown.allowed_of_the_pose if dynamics.pose else s.unknown.allowed)(s.c.monitor)
    unit = f"{allowed.disturbance_m_s2:.3g} m/s^2"
    if dynamics.pose:
        unit += f" or {allowed.disturbance_rad_s2:.3g} rad/s^2"
    r.add(
        "controller",
        "monitored: error growth that a disturbance of {unit} cannot explain {what}",
        unit=unit,
        what={"log": "is only logged", "warn": "is a warning", "fault": "is a fault"}[action],
    )


def encoders(r: Report) -> None:
    """Add the limits of the encoder rules, and the length error that each undetectable fault leaves.

    The limits hold at rest and at constant force; motion and force widen them.
    """
    s, c, limits = r.s, r.s.c, r.s.encoders
    T, noise_m = s.period_s, limits.length_noise_m
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
    r.figures["encoders"] = figures = {
        "jump_m": jump_m,
        "slip_m": slip_m,
        "leap_m_s": leap_m_s,
        "standstill_m": noise_m,
        "strayed_m": SUSPECT * noise_m,
        "push_N": limits.push_N.tolist(),
        "push_s": limits.push_ticks * T,
        "drift_of_length_alone_m_s": slip_m / WINDOW_S,
        "scale_of_rate_alone": limits.rate_error + limits.unshared * T / WINDOW_S,
        "not_observable": {"late_m": c.limits.speed_m_s * T, "frozen_m": SUSPECT * noise_m},
    }
    least, stated = steps(c, c.loop.rate_Hz), c.monitor
    then, ways = ("beyond known friction", "one way") if limits.sticks else ("then", "each way")
    r.add(
        "encoders at rest",
        """
        resolution  of lengths: {length_m:micro.3g} um is used, monitor.length_noise_m is smaller
        resolution  of rates: {rate_m_s:milli.3g} mm/s is used, monitor.rate_noise_m_s is smaller
        jump        {jump_m:milli.3f} mm from one reading to the next {beside}
        slip        {slip_m:milli.3f} mm and {share:percent.3g} % of the travel in {window_s:milli.6g} ms
        rate        {leap_m_s:.3f} m/s of one leg in a tick, which force and disturbance do not explain
        standstill  within {standstill_m:micro.6g} um while a leg strays by {strayed_m:milli.6g} mm; {then}
                    a push of up to {most_N:.0f} N,
                    more than {friction_N:g} N of friction, {push_s:milli.0f} ms {ways}
        drift       of length and rate: {unseen} in motion, at any
                    speed; leaves speed x time. On closed brakes BRAKE beyond {braked_m:milli.6g} mm
        scale       of length and rate: {unseen} at any size;
                    leaves share x travel
        either      of length or rate alone: found beyond {drift_m_s:milli.2f} mm/s and {share:percent.3g} %
                    of the leg's speed; a step of the rate beyond {leap_m_s:.3f} m/s is a leap
        a tick late {unseen}; leaves {late_m:milli.2f} mm at limits.speed_m_s
        frozen      at true rest: {unseen}; leaves nothing until a leg strays
        """
        if limits.watched_legs
        else "checked by the filter of the fused pose, with the tracker: see encoder_slip_m",
        figures,
        length_m=least.length_m if least.length_m > stated.length_noise_m else None,
        rate_m_s=least.rate_m_s if least.rate_m_s > stated.rate_noise_m_s else None,
        beside="that makes the rate leap" if limits.differences else "more than the rate",
        share=figures["scale_of_rate_alone"],
        window_s=WINDOW_S,
        then=then,
        most_N=limits.push_N.max(),
        friction_N=friction_N(c),
        ways=ways,
        unseen="not observable with these sensors",
        braked_m=c.limits.standstill_m,
        drift_m_s=slip_m / WINDOW_S,
        late_m=c.limits.speed_m_s * T,
    )


def fusion(r: Report) -> None:
    """Add standard deviations of lengths, rates and unknown forces to the report, if the pose is fused."""
    c = r.s.c
    if c.estimation.pose != "fused":
        return
    stated = c.estimation.fusion.leg_force_std_N is not None or c.monitor.friction_N is not None
    emulated = c.plant is not None and not isinstance(c.plant.model, FmuPlant)
    r.figures["fusion"] = figures = leg_errors(c)._asdict()
    known = bool(figures["force_std_N"] > 0.0)
    r.add(
        "fused pose, standard deviations",
        """
        leg lengths    {length_std_m:micro.3g} um
        leg rates      {rates}, {rate_scale_std:percent.2g} % of the rate
        unknown forces {force_std_N:g} N over {time_ms:g} ms{assumed}
        unknown forces {none}: the model counts as exact; an unknown force makes the filter reject good legs
        """,
        figures,
        rates=f"{1e3 * figures['rate_std_m_s']:.3g} mm/s, {1e6 * figures['rate_skew_std_s']:.3g} us of the "
        "acceleration",
        time_ms=1e3 * figures["force_time_s"] if known else None,
        assumed=""
        if stated or emulated
        else " (assumed); state monitor.friction_N or estimation.fusion.leg_force_std_N as measured",
        none=None if known else "none",
    )
