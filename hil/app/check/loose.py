"""Limits so far beyond what the path and all beside it need that they would show a failure late.

What a limit needs is the path, changes of speed, jogs, the stated disturbance, pushes, and what is read.
"""

from collections.abc import Callable, Mapping
from math import ceil, inf, sqrt
from typing import NamedTuple

import numpy as np

from hil.app.check.subject import Subject
from hil.mathematics.rounding import raised

FACTOR = 4.0
"""A limit this many times above what is needed protects from little."""
FAR = 20.0
"""The same where what is needed is known less well: noise, a leg on its brake, lateness."""
ILL = 40.0
"""The same of the condition of J, which is 2 to 3 at best: its limit is where figures lose their digits."""
ROOM = 2.5
"""Times what is needed that is proposed for `FACTOR`, as `hil new` has it; for the others the root."""
QUINTIC_PEAK = 1.875
"""Peak over mean speed of the approach."""
SHARES = (0.01, 0.025)
"""Of the stroke: an error of a leg is never taken to need less, nor more, whatever the law leaves."""
READING_m = 1e-5
"""A reading of a length is not taken to be better."""
GIVE_m = 1e-4
"""What a brake gives way under load."""
ACTS = 2.0
"""A change of force by more than so many times the largest force cannot be asked for."""
SKEW = 0.1
"""Of the period: SYNCs of several buses are no farther apart by themselves."""
NOTHING = 1e-9
"""Less, in the limit's own unit, is what rounding leaves: nothing is needed, and any limit is as good."""


class Limit(NamedTuple):
    """A limit of section `limits`, and what needs it."""

    name: str
    needed: Callable[[Subject], float | None]
    """In its unit; None: it cannot be known."""
    unit: str
    factor: float = FACTOR
    by: str = "on the path"


def loose(s: Subject) -> list[Mapping[str, object]]:
    """Return the limits that are their factor above what is needed, with a proposal."""
    found: list[Mapping[str, object]] = []
    moves_mm = 1e3 * s.fastest_m_s * s.c.limits.stale_fault_ticks * s.period_s
    for each in LIMITS:
        value: float | None = getattr(s.c.limits, each.name)
        needed = None if value is None else each.needed(s)
        if value is None or needed is None or needed <= NOTHING or value <= each.factor * needed:
            continue
        room = ROOM if each.factor == FACTOR else sqrt(each.factor)
        give = raised(room * needed)
        give = float(ceil(give)) if each.unit == "ticks" else give
        by = each.by.format(moves_mm=moves_mm)
        row = {"name": each.name, "unit": each.unit, "by": by, "value": value, "needed": needed}
        found.append(row | {"times": value / needed, "give": give})
    return found


def _disturbed_N(s: Subject) -> float:
    """Return the force on one leg that accelerates it by the stated disturbance, N."""
    return s.c.monitor.disturbance_m_s2 * s.leg_mass_kg


def _most_N(s: Subject) -> float:
    return ACTS / FACTOR * min(s.c.limits.force_N, s.c.drives.force_limit_N)


def _step_N(s: Subject) -> float:
    own = s.own_step_N + (s.slowed.step_N if s.slowed else 0.0)
    return max(own, min(_disturbed_N(s), _most_N(s)))


def _window_N(s: Subject) -> float | None:
    swings = s.walk.swings(s.period_s)
    if swings is None:
        return None
    pushed_N = (1.0 if s.encoders.sticks else 2.0) * float(s.encoders.push_N.max())
    swing_N, jogged_N = float(swings.max()), s.jogged.change_N if s.jogged else 0.0
    return max(swing_N, jogged_N, min(swing_N + max(_disturbed_N(s), pushed_N), _most_N(s)))


def _speed(s: Subject) -> float:
    jogged = s.jogged.rate_m_s if s.jogged else 0.0
    fastest = s.setpoints[0] if s.setpoints else 0.0
    return max(s.fastest_m_s, QUINTIC_PEAK * s.c.engage.approach_speed_m_s, jogged, fastest)


def _acceleration(s: Subject) -> float:
    own = s.slowed.acceleration_m_s2 if s.slowed else float(np.abs(s.walk.ddq).max())
    return max(own, s.setpoints[1] if s.setpoints else 0.0)


def _noise_m(s: Subject) -> float:
    return max(s.encoders.length_noise_m, READING_m)


def _error_m(s: Subject) -> float:
    """Return what disturbance and steps of the force leave of an error at rest, within `SHARES`, m."""
    error_m = inf
    if s.dynamics is not None and np.min(s.dynamics.K_P) > 0.0:
        error_m = s.c.monitor.disturbance_m_s2 / float(np.min(s.dynamics.K_P)) + (s.stepped_error_m or 0.0)
    return min(max(error_m, SHARES[0] * s.stroke_m), SHARES[1] * s.stroke_m)


LIMITS = (
    Limit("force_N", lambda s: s.peak_N, "N"),
    Limit("force_step_N", _step_N, "N", by="in a tick on the path, or as the stated disturbance comes"),
    Limit(
        "force_window_N",
        _window_N,
        "N",
        by="within 250 ms on the path, with the stated disturbance and pushes, or in a jog",
    ),
    Limit("speed_m_s", _speed, "m/s", by="on the path, on the way to it and in a jog"),
    Limit("acceleration_m_s2", _acceleration, "m/s^2", FAR),
    Limit("condition", lambda s: float(s.walk.condition.max()), "of J", ILL),
    Limit("following_error_m", _error_m, "m", by="by the stated disturbance and 1 to 2.5 % of the stroke"),
    Limit("following_error_s", lambda s: s.delay.total_s, "s", FAR, "by the delay of the loop"),
    Limit("consistency_m", _noise_m, "m", FAR, "by what is read"),
    Limit(
        "standstill_m",
        lambda s: max(2.0 * _noise_m(s), GIVE_m),
        "m",
        FAR,
        "by a brake that gives way under load",
    ),
    Limit(
        "stale_fault_ticks",
        lambda _: 1.0,
        "ticks",
        FAR,
        "where a frame is late: meanwhile a leg moves {moves_mm:.3g} mm unheard",
    ),
    Limit("missed_stop_ticks", lambda _: 1.0, "ticks", FAR, "where the loop wakes late"),
    Limit(
        "sync_skew_us",
        lambda s: 1e6 * SKEW * s.period_s if s.c.bus.channels else None,
        "us",
        by="a tenth of the period",
    ),
)
