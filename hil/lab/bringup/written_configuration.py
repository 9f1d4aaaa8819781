"""Text of the configuration that a bring-up writes; its head comments give the source of each number."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from drivers.signals import LEGS
from drivers.transmission import Transmission
from hil.app.configuration.changes import with_changes
from hil.app.configuration.configuration import Configuration
from hil.config.reference import WaypointReference
from hil.lab.bringup.context import Context, Finding

SPEED_SHARE = 0.25
"""Share of the configured leg speed limit for the first runs."""
FIRST_S, FIRST_M = 4.0, 1e-3
"""Duration of the first motion, and its amplitude on each axis: with twice that a leg that sticks would
exceed FOLLOWING_M before it breaks away."""
FIRST_deg = 0.3, 0.2, 0.4
"""Amplitude of its rotation vector. At a symmetric pose a pure heave moves all legs alike, which would hide
exchanged motors."""
FOLLOWING_SHARE, FOLLOWING_M = 0.2, 2e-3
"""Share of the configured limit of the tracking error for the first runs, and its lower bound, m.

A tight limit ends a faulty run sooner; the lower bound leaves room for stick-slip.
"""


def found_text(
    c: Configuration,
    context: Context,
    findings: Sequence[Finding],
    *,
    released: bool = False,
    rehearsed: bool = False,
) -> str:
    """The given configuration with the values found, reduced limits, and comments on their sources.

    released: the six legs have moved together. rehearsed: an emulated bench was measured.
    """
    speed, following = c.limits.speed_m_s, c.limits.following_error_m
    head = [
        f"{c.name}, as `hil bringup` has found it; comments of the given file are not repeated.",
        f"limits: reduced for the first runs, {speed:g} m/s and {following:g} m were given; raise them later",
        "reference: the first motion of all six legs; then your own",
        *_sources(context),
    ]
    if rehearsed:
        head.append("REHEARSAL: its figures are those of an emulated bench, no machine was measured.")
    if findings:
        done = corrected(c, context, findings)
        head.append("NOT RELEASED: fix the findings below, if any, and run `hil bringup` with this file.")
        head += [f"  {finding.line}" for finding in findings if finding not in done]
        if done:
            head.append("This file already corrects these findings: do not fix them at the machine as well.")
        head += [f"  {finding._replace(remedy='').line.rstrip(' .')}" for finding in done]
    elif not released:
        head.append("NOT RELEASED: the step `together` has not passed. Repeat the command.")
    return "".join(f"# {line}\n" for line in head) + with_changes(c.text, _changes(c, context, findings))


def corrected(c: Configuration, context: Context, findings: Sequence[Finding]) -> list[Finding]:
    """Findings that the written configuration compensates, so that no repair at the machine is needed.

    With exchanged node numbers or crossed cables, a drive was read with the sign, lead and zero of another
    leg. Both must be fixed before sign, lead and zero.
    """
    names = {"stroke"}
    if _order(c, context, findings) is not None:
        names |= {"ids"}
    if _has_gear(c, findings):
        names |= {"wrong_lead", "drive_reversed", "offset"}
    return [finding for finding in findings if finding.name in names]


def _has_gear(c: Configuration, findings: Sequence[Finding]) -> bool:
    """True if the configuration has a transmission to correct and each drive reads its own leg."""
    misread = any(finding.name in {"ids", "encoder_crossed"} for finding in findings)
    return c.drives.transmission is not None and not misread


def _changes(c: Configuration, context: Context, findings: Sequence[Finding]) -> dict[str, Any]:
    speed, following = c.limits.speed_m_s, c.limits.following_error_m
    x, y, z = c.platform.home.position_m
    turned = list(c.platform.home.rotation_vector_deg)
    points = [
        {
            "t_s": share * FIRST_S,
            "position_m": [x + part * FIRST_M, y + part * FIRST_M, z + part * FIRST_M],
            "rotation_vector_deg": np.add(turned, np.multiply(part, FIRST_deg)).tolist(),
        }
        for share, part in ((0.0, 0.0), (0.25, 1.0), (0.75, -1.0), (1.0, 0.0))
    ]
    first = {"type": "waypoints", "interpolation": "quintic", "periods": 1, "points": points}
    # the limits of a file that a bring-up has written are reduced already
    if WaypointReference.model_validate(first) != c.reference:
        speed *= SPEED_SHARE
        following = min(following, max(FOLLOWING_SHARE * following, FOLLOWING_M))
    changes: dict[str, Any] = {
        "limits": {"speed_m_s": speed, "following_error_m": following},
        "engage": {"approach_speed_m_s": min(c.engage.approach_speed_m_s, 0.5 * speed)},
        "reference": first,
        "drives": {"node_ids": _order(c, context, findings) or list(c.drives.node_ids)},
    }
    if any(f.name == "stroke" for f in findings):
        ends = np.array([fact["tape_m"] for fact in context.table("encoder").values()])
        changes["platform"] = {
            "length_min_m": round(float(ends[:, 0].max()) + 1e-3, 4),
            "length_max_m": round(float(ends[:, 1].min()) - 1e-3, 4),
        }
    if _has_gear(c, findings):
        changes["drives"]["transmission"] = _transmission(c, context, findings)
    return changes


def _order(c: Configuration, context: Context, findings: Sequence[Finding]) -> list[int] | None:
    """Node numbers (6) by leg if drives are exchanged among each other, else None."""
    nodes, reads = list(c.drives.node_ids), context.reads()
    exchanged = [drive for finding in findings if finding.name == "ids" for drive in finding.legs]
    for drive in exchanged:
        nodes[reads[drive][0]] = c.drives.node_ids[drive]
    return nodes if exchanged and len(set(nodes)) == LEGS else None


def _transmission(c: Configuration, context: Context, findings: Sequence[Finding]) -> dict[str, Any]:
    """Sign, lead or pulley radius, and offset of each leg, so that readings agree with the tape."""
    settings = c.drives.transmission
    assert settings is not None
    gear = Transmission(settings)
    lead, sign, offset = gear.lead_m.copy(), gear.sign.copy(), gear.offset_m.copy()
    for finding in findings:
        for leg in finding.legs:
            fact = context.known("encoder", leg)
            if finding.name == "wrong_lead":
                lead[leg] /= abs(fact["scale"])
            elif finding.name == "drive_reversed":
                sign[leg] *= -1.0
            elif finding.name == "offset":
                offset[leg] -= fact["offset_m"]
            if finding.name in {"wrong_lead", "drive_reversed"}:  # about the middle of the stroke
                middle, zero = 0.5 * float(sum(fact["tape_m"])), float(gear.offset_m[leg])
                offset[leg] += middle + (zero - middle - fact["offset_m"]) / fact["scale"] - zero
    changes: dict[str, Any] = {
        "sign": [int(s) for s in sign],
        "offset_m": [round(float(x), 5) for x in offset],
    }
    if not np.array_equal(lead, gear.lead_m):
        key, share = ("lead_m", 1.0) if settings.lead_m is not None else ("pulley_radius_m", 0.5 / np.pi)
        changes[key] = [float(f"{share * x:.6g}") for x in lead]
    return changes


def _sources(context: Context) -> list[str]:
    """Comment lines on the source of each measured number."""
    lines = ["drives.node_ids: each leg moved by hand and by its drive"]
    watchdogs = context.table("watchdog").values()
    latest = [fact["until_s"] for fact in watchdogs if fact["until_s"] is not None]
    if len(latest) < LEGS and not context.drives.protocol.traits.has_watchdog:
        lines.append(
            "drives.watchdog_ms: NOT proven, this program does not set it; cut the drives' power otherwise"
        )
    elif latest:
        lines.append(f"drives.watchdog_ms: proven by silence, {1e3 * max(latest):.4g} ms at the latest")
    if context.table("encoder"):
        lines.append("platform, drives.transmission: lengths by tape, see the checklist")
    return lines
