"""What laws that do not linearise the robot have in common: what is asked of the reference, the loop."""

from dataclasses import replace
from math import isfinite, pi
from typing import Any

import numpy as np

from drivers.arrays import Array
from hil.app.stability.subject import NO_PAYLOAD, Subject
from hil.design.stability.coupled import delay_margin_s, growth, resonances
from hil.mathematics.linear_system import LinearSystem
from hil.robot.kinematics import jacobian


def at_rest(subject: Subject) -> list[str]:
    """Return what a proof of a set-point asks of the reference."""
    rests = subject.rest and not subject.live
    conditions = [] if rests else ["the reference rests; while it moves nothing is proven"]
    conditions += subject.unseen
    if subject.c.drives.transmission is not None:
        conditions.append("the drives give what is asked: their steps and losses are left out")
    elif subject.drives.stepped:
        conditions.append("forces and readings have no steps")
    if not replace(subject.stated, payload=NO_PAYLOAD).nothing:
        conditions.append("no load: of these laws no ultimate bound is computed")
    return conditions


def sampled_loop(
    subject: Subject,
    controller: LinearSystem,
    mobility: Array,
    stiffness: Array,
    where: str,
) -> tuple[list[str], dict[str, Any], float]:
    """Return the loop that runs as lines, figures, and its largest |z|.

    stiffness (6, 6): of the axes themselves.
    """
    radius = growth(subject.axis, controller, mobility, stiffness)
    figures: dict[str, Any] = {"sampled": {"largest_pole": radius}}
    line = f"sampled loop   largest |z| {radius:.4f} {where}, all axes together"
    if radius < 1.0 and not _too_fast(subject, mobility, stiffness):
        margin = delay_margin_s(subject.axis, controller, mobility, stiffness)
        figures["sampled"]["delay_margin_ms"] = 1e3 * margin if isfinite(margin) else None
        line += f"; bears {1e3 * margin:.3g} ms of further delay"
    return [line], figures, radius


def _too_fast(subject: Subject, mobility: Array, stiffness: Array) -> bool:
    """Tell whether axes swing by themselves beyond half the rate, where a response tells no delay."""
    return bool((resonances(mobility, stiffness) >= pi / subject.axis.period_s).any())


def unstable(subject: Subject, radius: float) -> str:
    """Say that the sampled loop is not stable."""
    return (
        f"the sampled loop has an eigenvalue of magnitude {radius:.4g} with {subject.delay}: lower the gains"
    )


def inertia(subject: Subject, p: Array, R: Array) -> tuple[Array, Array]:
    """Return J and M^-1."""
    M = subject.robot.mass_matrix(p, R)
    return jacobian(subject.platform, p, R), np.asarray(np.linalg.inv(M), float)
