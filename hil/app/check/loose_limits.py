"""Finds limits far above what the path and its disturbances need: they would detect a failure late.

The need of a limit covers the path, speed changes, jogs, the stated disturbance, pushes and noise.
"""

from collections.abc import Mapping
from math import ceil, inf, sqrt
from typing import NamedTuple

import numpy as np

from hil.app.check.demand import JogDemand
from hil.app.check.subject import Subject
from hil.mathematics.rounding import raised

FACTOR = 4.0
"""Ratio of limit to need above which a limit protects little."""
FAR = 20.0
"""This ratio for needs known less well: noise, a leg on its brake, lateness."""
ILL = 40.0
"""This ratio for the condition number of J, at best 2 to 3: its limit is where figures lose digits."""
ROOM = 2.5
"""Ratio of proposal to need with `FACTOR`, as in `hil new`; with other factors their square root."""
QUINTIC_PEAK = 1.875
"""Ratio of peak to mean speed of the approach."""
SHARES = (0.01, 0.025)
"""Smallest and largest need of a leg error, as shares of the stroke, for every law."""
READING_m = 1e-5
"""Least noise of a length reading, m."""
GIVE_m = 1e-4
"""Yield of a brake under load, m."""
ACTS = 2.0
"""Ratio of the largest possible change of a force to the largest force."""
SKEW = 0.1
"""Normal skew of the SYNCs of several buses, as a share of the period."""
NOTHING = 1e-9
"""Largest need, in the limit's own unit, that counts as a rounding error of zero."""


class Need(NamedTuple):
    """Smallest useful value of a limit, in its unit, and its cause; None: unknown."""

    needed: float | None
    unit: str
    by: str = "on the path"
    factor: float = FACTOR


def loose(s: Subject) -> list[Mapping[str, object]]:
    """Limits that exceed their need by more than their factor, with a proposed value."""
    found: list[Mapping[str, object]] = []
    for name, (needed, unit, by, factor) in needs(s).items():
        value: float | None = getattr(s.c.limits, name)
        if value is None or needed is None or needed <= NOTHING or value <= factor * needed:
            continue
        give = raised((ROOM if factor == FACTOR else sqrt(factor)) * needed)
        row = {"name": name, "unit": unit, "by": by, "value": value, "needed": needed}
        found.append(row | {"times": value / needed, "give": float(ceil(give)) if unit == "ticks" else give})
    return found


def needs(s: Subject) -> dict[str, Need]:
    """Smallest useful value of each key of section `limits`."""
    c, swings, stroke_m = s.c, s.walk.swings(s.period_s), s.stroke_m
    disturbed_N = c.monitor.disturbance_m_s2 * s.leg_mass_kg
    most_N = ACTS / FACTOR * min(c.limits.force_N, c.drives.force_limit_N)
    jogged = s.jogged or JogDemand(0.0, 0.0)
    fastest_m_s, hardest_m_s2 = s.setpoints or (0.0, 0.0)
    own_m_s2 = s.slowed.acceleration_m_s2 if s.slowed else float(np.abs(s.walk.ddq).max())
    step_N = s.own_step_N + (s.slowed.step_N if s.slowed else 0.0)
    window_N = None
    if swings is not None:
        swing_N = float(swings.max())
        pushed_N = (1.0 if s.encoders.sticks else 2.0) * float(s.encoders.push_N.max())
        window_N = max(swing_N, jogged.change_N, min(swing_N + max(disturbed_N, pushed_N), most_N))
    approach_m_s = QUINTIC_PEAK * c.engage.approach_speed_m_s
    error_m = inf  # at rest, by disturbance and force resolution
    if s.dynamics is not None and np.min(s.dynamics.K_P) > 0.0:
        error_m = c.monitor.disturbance_m_s2 / float(np.min(s.dynamics.K_P)) + (s.stepped_error_m or 0.0)
    error_m = min(max(error_m, SHARES[0] * stroke_m), SHARES[1] * stroke_m)
    reading_m = max(s.encoders.length_noise_m, READING_m)
    skew_us = 1e6 * SKEW * s.period_s if c.bus.channels else None
    moves_mm = 1e3 * s.fastest_m_s * c.limits.stale_fault_ticks * s.period_s
    late = f"for a late frame, while a leg moves {moves_mm:.3g} mm without feedback"
    step = "in a tick on the path, or at the onset of the stated disturbance"
    window = "within 250 ms on the path, with the stated disturbance and pushes, or in a jog"
    speed = "on the path, on the way to it and in a jog"
    error = "by the stated disturbance and 1 to 2.5 % of the stroke"
    return {
        "force_N": Need(s.peak_N, "N"),
        "force_step_N": Need(max(step_N, min(disturbed_N, most_N)), "N", step),
        "force_window_N": Need(window_N, "N", window),
        "speed_m_s": Need(max(s.fastest_m_s, approach_m_s, jogged.rate_m_s, fastest_m_s), "m/s", speed),
        "acceleration_m_s2": Need(max(own_m_s2, hardest_m_s2), "m/s^2", factor=FAR),
        "condition": Need(float(s.walk.condition.max()), "of J", factor=ILL),
        "following_error_m": Need(error_m, "m", error),
        "following_error_s": Need(s.delay.total_s, "s", "by the delay of the loop", FAR),
        "consistency_m": Need(reading_m, "m", "for the noise of readings", FAR),
        "standstill_m": Need(max(2.0 * reading_m, GIVE_m), "m", "for a brake that yields under load", FAR),
        "stale_fault_ticks": Need(1.0, "ticks", late, FAR),
        "missed_stop_ticks": Need(1.0, "ticks", "for a late wake-up of the loop", FAR),
        "sync_skew_us": Need(skew_us, "us", "a tenth of the period"),
    }
