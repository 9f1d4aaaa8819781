"""The part of `hil check` that says what a payload known by ranges asks of legs, limits and safety."""

from typing import NamedTuple

import numpy as np

from drivers.arrays import Array
from hil.app.check.findings import Report
from hil.app.configuration.configuration import Configuration
from hil.app.configuration.payload_box import corners, shown_ranges
from hil.app.configuration.platform import build_platform, pose_arrays
from hil.app.reachability import Violation, Walk, span_s, violations, walk
from hil.app.unknown_payload import unknown_payload
from hil.robot.dynamics import Model
from hil.trajectory.path import Trajectory


class Carried(NamedTuple):
    """A walk along the reference with another payload than the model's."""

    words: str
    static: Array
    """(6,) N, what holds the robot at home."""
    walk: Walk
    broken: list[Violation]
    """Limits that it breaks, each with its first instant."""


def carried_along(c: Configuration, trajectory: Trajectory) -> list[Carried]:
    """Return the walk at each corner of the payload's ranges; none without ranges."""
    period, found = 1.0 / c.loop.rate_Hz, []
    home, still = pose_arrays(c.platform.home), np.zeros(6)
    for corner in corners(c.platform)[1:]:
        platform = build_platform(corner.settings)
        model = Model(platform, leg_spin=c.platform.leg_spin)
        w = walk(platform, model, trajectory, span_s(trajectory), period, c.plant)
        broken = violations(w, c.platform, c.limits, period)
        found.append(Carried(corner.words, model.inverse_dynamics(*home, still, still), w, broken))
    return found


def broken_by(found: list[Carried]) -> list[str]:
    """Return each limit that a payload breaks, in words, by the one that breaks it first."""
    by_limit: dict[str, list[tuple[Violation, str]]] = {}
    for one in found:
        for violation in one.broken:
            by_limit.setdefault(violation.limit, []).append((violation, one.words))
    lines = []
    for all_of in by_limit.values():
        first, words = min(all_of)
        more = f" and {len(all_of) - 1} other corners of the ranges" if len(all_of) > 1 else ""
        lines.append(
            f"with {words}{more}, at t = {first.t:.3f} s: {first.message}; narrow mass_range_kg or "
            "com_range_m, take a gentler reference, or raise the limit if legs and drives bear it"
        )
    return lines


def report_payload(report: Report, c: Configuration, found: list[Carried]) -> None:
    """Add what the ranges of a payload ask for to the report; nothing without ranges."""
    if not found:
        return
    static = np.array([one.static for one in found])
    forces = np.array([(one.walk.tau.min(), one.walk.tau.max()) for one in found])
    unknown = unknown_payload(c)
    body = next(one for one in c.platform.platform.payload if one.ranged)
    report.sections[f"payload {shown_ranges(body)}"] = [
        f"static forces  {static.min():.0f} to {static.max():.0f} N at home",
        f"leg forces     {forces.min():.0f} to {forces.max():.0f} N (limit {c.limits.force_N:g})",
        f"acceleration   up to {unknown.leg:.3g} m/s^2 of a leg under forces for the model's payload,",
        f"               {unknown.position:.3g} m/s^2, {unknown.rotation:.3g} rad/s^2 of the pose: rules on",
        "               encoders, and the monitor, add it to the disturbances of section monitor",
    ]
    report.figures["payload"] = {
        "static_force_min_N": float(static.min()),
        "static_force_max_N": float(static.max()),
        "force_min_N": float(forces.min()),
        "force_max_N": float(forces.max()),
        "acceleration_m_s2": unknown.leg,
    }
