"""Limits so far beyond what the path and all beside it need that they would show a failure late.

What a limit needs is the path, changes of speed, jogs, the stated disturbance, pushes, and what is read.
"""

from collections.abc import Iterator
from math import ceil
from typing import NamedTuple

import numpy as np

from hil.app.check.operating import SpeedChange
from hil.app.check.setpoints import setpoint_peaks
from hil.app.configuration.configuration import Configuration
from hil.app.encoder_limits import encoder_limits
from hil.app.force_steps import stepped_error_m
from hil.app.loop_delay import loop_delay
from hil.app.reachability import Walk
from hil.app.unknown_payload import unknown_payload
from hil.config.reference import LiveReference
from hil.control.law import ErrorDynamics
from hil.mathematics.rounding import lowered, raised
from plant_fmu.config import BenchPlant

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
    """A limit and what needs it."""

    name: str
    value: float
    needed: float
    unit: str
    factor: float = FACTOR
    by: str = "on the path"

    @property
    def proposed(self) -> float:
        """Return a value with room, of ticks a whole one."""
        room = ROOM if self.factor == FACTOR else float(np.sqrt(self.factor))
        value = raised(room * self.needed)
        return float(ceil(value)) if self.unit == "ticks" else value


def loose_limits(
    c: Configuration, w: Walk, change: SpeedChange | None, jogged: tuple[float, float] = (0.0, 0.0)
) -> Iterator[str]:
    """Yield the limits of section `limits` that would show a failure late.

    w: the walk along the reference; change: what a change of speed along it asks for, None where it is live;
    jogged: by how much a jog changes a force within 250 ms, N, and the rate of a leg in it, m/s.
    The layout ideal drives no hardware, so no limit protects anything there.
    """
    if c.bus.layout == "ideal":
        return
    for each in (*_on_the_path(c, w, change, jogged), *_as_read(c, w)):
        if each.needed > NOTHING and each.value > each.factor * each.needed:
            yield (
                f"limits.{each.name} {each.value:g} is {each.value / each.needed:.1f} times the "
                f"{each.needed:.3g} {each.unit} that are needed {each.by}; it would show a failure late, "
                f"give {each.proposed:g}"
            )
    yield from _unbraked(c, w)


def _on_the_path(
    c: Configuration, w: Walk, change: SpeedChange | None, jogged: tuple[float, float]
) -> Iterator[Limit]:
    """Yield the limits of force and motion."""
    limits, encoders = c.limits, encoder_limits(c, c.loop.rate_Hz)
    pushed_N = (1.0 if encoders.sticks else 2.0) * float(encoders.push_N.max())
    swings, disturbed_N = w.swings(1.0 / c.loop.rate_Hz), _disturbed_N(c)
    speed = max(float(np.abs(w.dq).max()), QUINTIC_PEAK * c.engage.approach_speed_m_s)
    jogged_N, jogged_m_s = jogged
    speed, acceleration = max(speed, jogged_m_s), float(np.abs(w.ddq).max())
    step_N = float(np.abs(w.steps()[1]).max())
    if change is not None:
        acceleration, step_N = change.acceleration_m_s2, step_N + change.step_N
    if isinstance(c.reference, LiveReference):
        fastest, hardest = setpoint_peaks(c, c.reference)
        speed, acceleration = max(speed, fastest), max(acceleration, hardest)
    yield Limit("force_N", limits.force_N, float(np.abs(w.tau).max()), "N")
    most_N = ACTS / FACTOR * min(limits.force_N, c.drives.force_limit_N)
    by = "in a tick on the path, or as the stated disturbance comes"
    yield Limit("force_step_N", limits.force_step_N, max(step_N, min(disturbed_N, most_N)), "N", by=by)
    if swings is not None:
        swing_N = float(swings.max())
        needed = max(swing_N, jogged_N, min(swing_N + max(disturbed_N, pushed_N), most_N))
        by = "within 250 ms on the path, with the stated disturbance and pushes, or in a jog"
        yield Limit("force_window_N", limits.force_window_N, needed, "N", by=by)
    yield Limit("speed_m_s", limits.speed_m_s, speed, "m/s", by="on the path, on the way to it and in a jog")
    if limits.acceleration_m_s2 is not None:
        yield Limit("acceleration_m_s2", limits.acceleration_m_s2, acceleration, "m/s^2", FAR)
    number = float(w.condition.max())
    yield Limit("condition", limits.condition, number, "of J", ILL)


def _as_read(c: Configuration, w: Walk) -> Iterator[Limit]:
    """Yield the limits of errors, readings and lateness."""
    limits, T = c.limits, 1.0 / c.loop.rate_Hz
    noise_m = max(encoder_limits(c, c.loop.rate_Hz).length_noise_m, READING_m)
    stroke_m = c.platform.length_max_m - c.platform.length_min_m
    error_m = min(max(_error_m(c), SHARES[0] * stroke_m), SHARES[1] * stroke_m)
    by = "by the stated disturbance and 1 to 2.5 % of the stroke"
    yield Limit("following_error_m", limits.following_error_m, error_m, "m", by=by)
    by = "by the delay of the loop"
    yield Limit("following_error_s", limits.following_error_s, loop_delay(c).total_s, "s", FAR, by)
    by = "by what is read"
    yield Limit("consistency_m", limits.consistency_m, noise_m, "m", FAR, by)
    by = "by a brake that gives way under load"
    yield Limit("standstill_m", limits.standstill_m, max(2.0 * noise_m, GIVE_m), "m", FAR, by)
    moves_mm = 1e3 * float(np.abs(w.dq).max()) * limits.stale_fault_ticks * T
    by = f"where a frame is late: meanwhile a leg moves {moves_mm:.3g} mm unheard"
    yield Limit("stale_fault_ticks", limits.stale_fault_ticks, 1.0, "ticks", FAR, by)
    by = "where the loop wakes late"
    yield Limit("missed_stop_ticks", limits.missed_stop_ticks, 1.0, "ticks", FAR, by)
    if limits.sync_skew_us is not None and c.bus.channels:
        yield Limit("sync_skew_us", limits.sync_skew_us, 1e6 * SKEW * T, "us", by="a tenth of the period")


def _disturbed_N(c: Configuration) -> float:
    """Return the force on one leg that accelerates it by the stated disturbance, N."""
    return c.monitor.disturbance_m_s2 * _leg_mass_kg(c)


def _leg_mass_kg(c: Configuration) -> float:
    """Return what a leg feels of platform and rotor that moves alone: 1 / (J M^-1 J^T)_ii, kg."""
    if c.plant is not None and isinstance(c.plant.model, BenchPlant):
        return c.plant.model.mass_kg
    believed = c.controller.believed
    rotor_kg = 0.0 if believed is None else float(np.max(believed.reflected_mass_kg))
    mobility = np.diagonal(unknown_payload(c).mobility, axis1=1, axis2=2)
    return float(1.0 / mobility.min()) + rotor_kg


def _error_m(c: Configuration) -> float:
    """Return the error at rest that the stated disturbance and steps of the force leave, m.

    inf: nothing is known of the law's error dynamics.
    """
    dynamics = c.controller.error_dynamics()
    if not isinstance(dynamics, ErrorDynamics) or not np.min(dynamics.K_P) > 0.0:
        return float("inf")
    return c.monitor.disturbance_m_s2 / float(np.min(dynamics.K_P)) + (stepped_error_m(c) or 0.0)


def _unbraked(c: Configuration, w: Walk) -> Iterator[str]:
    """Yield a braking way before the soft ends that no force keeps to."""
    spare_N = min(c.limits.force_N, c.drives.force_limit_N) - float(np.abs(w.rest).max())
    able = spare_N / _leg_mass_kg(c)
    if able > 0.0 and c.limits.deceleration_m_s2 > FACTOR * able:
        yield (
            f"limits.deceleration_m_s2 {c.limits.deceleration_m_s2:g} is "
            f"{c.limits.deceleration_m_s2 / able:.1f} times the {able:.3g} m/s^2 by which limits.force_N can "
            f"brake a leg that bears the platform: it would not stop before a hard end; "
            f"give {lowered(able):g}"
        )
