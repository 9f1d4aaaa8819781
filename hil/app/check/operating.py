"""What `hil check` says of operating: what a change of speed asks for, and whether the held key is heard."""

from collections.abc import Iterator
from itertools import product
from math import radians
from typing import NamedTuple

import numpy as np

from hil.app.check.findings import Report
from hil.app.compose import build_admission
from hil.app.configuration.configuration import Configuration
from hil.app.operate import REPEAT_S
from hil.app.reachability import Walk, drive_forces, span_s
from hil.config.reference import LiveReference
from hil.control.uncertainty import UncertaintySettings
from hil.loop.jogging import jog_path, setup_share
from hil.robot.dynamics import Model
from hil.robot.dynamics_kernels import inverse_dynamics_kernel, mass_matrix_kernel
from hil.robot.kinematics_kernels import jacobian_kernel
from hil.signals import JOG_NAMES
from hil.trajectory.override import CURVATURE, PEAK
from hil.trajectory.path import PoseSample, Trajectory
from plant_fmu.config import StewartPlant

MOST = 500
"""Instants at which the forces of a change of speed are looked at."""
JOGS = 25
"""Instants of the reference from which jogs are looked at."""
PAGE_REPEAT_S = 0.05
"""Between two key frames of the page of `hil watch`."""
LEAST_TICKS = 3
"""Of deadman_s: the loop takes what comes within a tick at its end."""
CREEPING = 1e-9
"""Share of the speed at which dry friction is whole, and nothing else is felt of the motion."""
EPS = 1e-9
SEVERAL = 3
"""Key frames that deadman_s has to hear: one may be late, one lost."""


class SpeedChange(NamedTuple):
    """The most that a change of speed along the reference asks of a leg, anywhere on it.

    At the share sigma of the speed ddq = sigma^2 ddq_d + (d sigma/dt) dq_d, with the rates of sigma at the
    bounds of `hil.trajectory.override`.
    """

    acceleration_m_s2: float
    added_m_s2: float
    """Of that, by (d sigma/dt) dq_d."""
    force_N: float
    step_N: float
    """From tick to tick, beside what the reference asks for."""
    felt_m_s2: float
    """|J M^-1 J^T tau|: what an error of the model's inertia and weight acts on."""


def speed_change(c: Configuration, w: Walk, trajectory: Trajectory, model: Model, span: float) -> SpeedChange:
    """Return what a change of speed within engage.stop_s asks for. span: of the walk, s."""
    T, period = c.engage.stop_s, 1.0 / c.loop.rate_Hz
    rate, curvature = PEAK / T, CURVATURE / T**2
    rows = np.unique(np.linspace(0, len(w.t) - 1, MOST).astype(np.int64))
    q, dq, moving = w.q[rows], w.dq[rows], w.tau[rows]
    platform, still = model.platform, np.zeros(6)
    held, slowing, mobility = np.empty_like(q), np.empty_like(q), np.empty((len(q), 6, 6))
    for k, t in enumerate(w.t[rows].tolist()):
        p, R, twist, dtwist = trajectory.sample(min(t, span * (1 - 1e-12)))
        robot = model.constants, model.code, p, R
        J = jacobian_kernel(platform.base_joints, platform.platform_joints, p, R)
        mobility[k] = J @ np.linalg.solve(mass_matrix_kernel(model.constants, p, R), J.T)
        held[k] = inverse_dynamics_kernel(*robot, still, still, still)
        faster = inverse_dynamics_kernel(*robot, twist, dtwist + twist, still)
        slowing[k] = faster - inverse_dynamics_kernel(*robot, twist, dtwist, still)
    none = np.zeros_like(q)
    at_rest = drive_forces(c.plant, q, none, none, none, none[:2])[0]
    slowing += drive_forces(c.plant, q, none, dq, none, none[:2])[0] - at_rest
    creeping = drive_forces(c.plant, q, CREEPING * dq, none, held, none[:2])[0]
    added, changed = rate * np.abs(w.dq), rate * slowing
    felt = [np.einsum("kij,kj->ki", mobility, moving + each) for each in (changed, -changed)]
    step = period * (curvature * np.abs(slowing) + 2.0 * rate * np.abs(moving - creeping))
    return SpeedChange(
        float((np.abs(w.ddq) + added).max()),
        float(added.max()),
        float((np.maximum(np.abs(moving), np.abs(creeping)) + np.abs(changed)).max()),
        float(step.max()),
        float(np.abs(felt).max()),
    )


class JogDemand(NamedTuple):
    """The most that a jog from anywhere on the reference asks of a leg, by each axis and leg, both ways."""

    change_N: float
    """Of a force within 250 ms, as the controller judges it; dry friction of our plant turns round once."""
    rate_m_s: float
    """Of the leg's length, where the jog begins."""


def jog_demand(c: Configuration, trajectory: Trajectory, model: Model, span: float) -> JogDemand:
    """Return what jogs ask for. span: of the walk, s."""
    admission, still, platform = build_admission(c, model.platform), np.zeros(6), model.platform
    speeds = c.operator.setup_speed_m_s, radians(c.operator.setup_speed_deg_s)
    plant = None if c.plant is None else c.plant.model
    friction_N = plant.coulomb_friction_N if isinstance(plant, StewartPlant) else 0.0
    change_N = rate_m_s = 0.0
    for t in np.linspace(0.0, span * (1 - 1e-12), JOGS).tolist():
        p, R, *_ = trajectory.sample(t)
        here = PoseSample(p, R, still, still)
        J = jacobian_kernel(platform.base_joints, platform.platform_joints, p, R)
        for axis, way in product(range(len(JOG_NAMES)), (1.0, -1.0)):
            start = jog_path(platform, here, axis, speeds, way).sample(0.0)
            share = setup_share(start, speeds)
            change_N = max(change_N, admission.change_N(start, share))
            rate_m_s = max(rate_m_s, float(np.abs(J @ (share * start.twist)).max()))
    return JogDemand(change_N + 2.0 * friction_N, rate_m_s)


def report_operating(
    report: Report, c: Configuration, w: Walk, trajectory: Trajectory, model: Model
) -> SpeedChange | None:
    """Add what operating asks for, with a warning for each limit that it may break.

    Returns what a change of speed asks for; None where the reference is live.
    """
    found: SpeedChange | None = None
    lines = report.sections["operating"] = []
    if not isinstance(c.reference, LiveReference):
        found = speed_change(c, w, trajectory, model, span_s(trajectory))
        lines.append(
            f"change of speed  adds up to {found.added_m_s2:.3g} m/s^2 to a leg, {found.step_N:.3g} N a tick,"
        )
        lines.append(
            f"                 to {found.acceleration_m_s2:.3g} m/s^2 and {found.force_N:.0f} N at most, by "
            f"engage.stop_s {c.engage.stop_s:g}"
        )
        report.figures["speed_change"] = found._asdict()
        report.warnings += _beyond(c, w, found)
        jog = jog_demand(c, trajectory, model, span_s(trajectory))
        lines.append(
            f"jog              changes a force by up to {jog.change_N:.0f} N within 250 ms (limit "
            f"{c.limits.force_window_N:g}),"
        )
        lines.append(
            f"                 moves a leg at up to {jog.rate_m_s:.3g} m/s (limit {c.limits.speed_m_s:g})"
        )
        report.figures |= {"jog_change_N": jog.change_N, "jog_rate_m_s": jog.rate_m_s}
        report.warnings += _jogged(c, jog)
    deadman_s = c.operator.deadman_s
    held = "none is needed" if deadman_s is None else f"held, heard within {1e3 * deadman_s:g} ms"
    lines.append(f"key              {held}")
    if deadman_s is not None:
        report.warnings += _key(c, deadman_s)
    return found


def _jogged(c: Configuration, jog: JogDemand) -> Iterator[str]:
    """Yield the limits that refuse a jog from the reference, or that it breaks."""
    speeds = (
        f"lower operator.setup_speed_m_s {c.operator.setup_speed_m_s:g} and setup_speed_deg_s "
        f"{c.operator.setup_speed_deg_s:g}"
    )
    if jog.change_N > c.limits.force_window_N:
        yield (
            f"a jog from the reference may change a force by {jog.change_N:.0f} N within 250 ms, "
            f"limits.force_window_N is {c.limits.force_window_N:g}: it is refused there; {speeds}, or "
            f"make engage.stop_s {c.engage.stop_s:g} longer"
        )
    if jog.rate_m_s > c.limits.speed_m_s:
        yield (
            f"a jog from the reference may move a leg at {jog.rate_m_s:.3g} m/s, limits.speed_m_s is "
            f"{c.limits.speed_m_s:g}: SPEED latches, and the brakes close; {speeds}"
        )


def _beyond(c: Configuration, w: Walk, found: SpeedChange) -> Iterator[str]:
    """Yield the limits that hold on the reference, and not while its speed changes."""
    mend = f"hold, start or a speed may fault there; make engage.stop_s {c.engage.stop_s:g} longer"
    allowed = c.limits.acceleration_m_s2
    if allowed is not None and found.acceleration_m_s2 > allowed:
        yield (
            f"a change of speed along the reference asks for {found.acceleration_m_s2:.3g} m/s^2 of a leg, "
            f"limits.acceleration_m_s2 is {allowed:g}; {mend}"
        )
    if found.force_N > c.limits.force_N:
        yield (
            f"a change of speed along the reference may take {found.force_N:.0f} N of a leg, "
            f"limits.force_N is {c.limits.force_N:g}; {mend}"
        )
    own = float(np.abs(w.steps()[1]).max())
    if own + found.step_N > c.limits.force_step_N:
        yield (
            f"a change of speed along the reference may change a force by {own + found.step_N:.0f} N in "
            f"a tick, limits.force_step_N is {c.limits.force_step_N:g}; {mend}"
        )
    stated = getattr(c.controller, "uncertainty", None)
    if not isinstance(stated, UncertaintySettings) or stated.acceleration_m_s2 is None:
        return
    if found.felt_m_s2 > stated.acceleration_m_s2:
        yield (
            f"controller.uncertainty.acceleration_m_s2 {stated.acceleration_m_s2:g}: while the speed "
            f"changes, forces over inertia are {found.felt_m_s2:.3g} m/s^2 without the law's "
            "linear part; state no less"
        )


def _key(c: Configuration, deadman_s: float) -> Iterator[str]:
    """Yield why a key that is held might count as let go."""
    said = f"operator.deadman_s {deadman_s:g}"
    clients = [
        ("`hil ctl key`", REPEAT_S),
        *([("the page of `hil watch`", PAGE_REPEAT_S)] if c.watch.operate else []),
    ]
    for client, every_s in clients:
        if deadman_s < SEVERAL * every_s - EPS:
            often = "each time" if deadman_s <= every_s + EPS else "where one comes late or is lost"
            yield (
                f"{said}: {client} speaks every {1e3 * every_s:g} ms, the platform comes to rest {often}; "
                f"give {SEVERAL * every_s:g} or more"
            )
    ticks = deadman_s * c.loop.rate_Hz
    if ticks < LEAST_TICKS - EPS:
        yield (
            f"{said}: {ticks:.3g} ticks at loop.rate_Hz {c.loop.rate_Hz:g}, too few for the loop to judge; "
            f"give {LEAST_TICKS / c.loop.rate_Hz:g} or more"
        )
