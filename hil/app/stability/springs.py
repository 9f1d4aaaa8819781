"""Stability of laws that act like springs on legs or pose, with weight compensation (PD, PID).

The proofs hold for a reference at rest only, which the claim states. Laws without an energy function are
assessed by the eigenvalues at the rest pose (Lyapunov's indirect method).
"""

from collections.abc import Callable
from dataclasses import replace
from math import inf, isfinite
from operator import itemgetter
from typing import Any

import numpy as np

from drivers.arrays import ZERO6, Array
from drivers.errors import ModelError
from drivers.tick_columns import TICK
from hil.app.stability.assessment import Assessment, unstable
from hil.app.stability.subject import NO_PAYLOAD, Subject
from hil.control.cartesian_pd import CartesianPDSettings
from hil.control.feedforward_pd import FeedforwardPDSettings
from hil.control.law import Law, LawContext, per_leg
from hil.control.pd import PDSettings
from hil.control.pd_gravity import PDGravitySettings
from hil.control.pid import PIDSettings
from hil.design.stability.springs import Forces, Springs, cubic_rest, rest, same_weight
from hil.robot.kinematics import jacobian, leg_lengths
from hil.robot.kinematics_kernels import jacobian_kernel, leg_lengths_kernel
from plant_fmu.config import BenchPlant

SpringSettings = PDSettings | PIDSettings | PDGravitySettings | FeedforwardPDSettings | CartesianPDSettings
AT_ONCE = (
    "forces act at once: V ignores sampling, delay and lag; the sampled loop has their effect on small "
    "errors at the rest pose"
)


WORST_FIRST = ("unstable", "not proven", "conditional", "proven")
FIGURES: tuple[tuple[str, str, Callable[..., tuple[float, str]]], ...] = (
    ("largest_pole", "largest |z| {:.4f}", max),
    ("delay_margin_ms", "delay {:.3g} ms of the loop alone", min),
    ("sag_mm", "sag {:.3g} mm", max),
    ("stiffness_N_m", "stiffness {:.4g} N/m", min),
    ("slowest_eigenvalue_1_s", "slowest eigenvalue {:+.3g} 1/s", max),
)
"""Figures that may be worse with another payload, and which of two values is worse."""


def at_rest(subject: Subject) -> list[str]:
    """Conditions on the reference under which the proof for a set-point holds."""
    rests = subject.rest and not subject.live
    conditions = [] if rests else ["the reference rests; while it moves nothing is proven"]
    conditions += subject.unseen
    if subject.c.drives.transmission is not None:
        conditions.append("the drives give the commanded force: resolution and losses are left out")
    elif subject.drives.stepped:
        conditions.append("forces and readings are not quantised")
    if not replace(subject.stated, payload=NO_PAYLOAD).nothing:
        conditions.append("no load: for these laws no ultimate bound is computed")
    return conditions


def springs(subject: Subject, law: SpringSettings) -> Assessment:
    """Result of the proof for a PD or PID: of the worst payload, with a line on figures worse with another.

    No payload is the worst in everything: the lightest leaves the smallest delay margin, the heaviest sags
    most.
    """
    found = [(one.carried[0], _judge(one, law)) for one in subject.alone()[::-1]]  # the stated payload first
    carried, chosen = min(found, key=lambda each: _badness(each[1]))
    if len(found) == 1:
        return chosen
    worst: dict[str, Any] = {}
    more, claim = list[str](), f"{chosen.claim}, with {carried}"
    for name, text, worse in FIGURES:
        values = [(value, words) for words, one in found[::-1] if (value := _figure(one, name)) is not None]
        if not values:
            continue
        value, words = worse(values, key=itemgetter(0))
        worst[name] = {"value": value, "carried": words}
        shown, here = text.format(value), _figure(chosen, name)
        if here is None or text.format(here) != shown:
            more.append(f"{shown} with {words}")
            if name == "sag_mm" and chosen.status == "conditional":
                claim += f"; {value:.3g} mm of leg length off the set-point with {words}"
    line = f"payloads       {len(found)} checked; claim and figures are with {carried}"
    if more:
        line += f"; worse with another: {'; '.join(more)}"
    figures = chosen.figures | {"carried": carried, "worst": worst}
    return chosen._replace(claim=claim, lines=[line, *chosen.lines], figures=figures)


def _badness(one: Assessment) -> tuple[int, float, float]:
    """Sort key, smallest for the worst result: status, delay margin in ms, negative largest pole."""
    margin, pole = _figure(one, "delay_margin_ms"), _figure(one, "largest_pole")
    delay = inf if margin is None else float(f"{margin:.6g}")  # equal but for rounding
    return WORST_FIRST.index(one.status), delay, -(pole or 0.0)


def _figure(one: Assessment, name: str) -> float | None:
    """Figure of a result by name, the smallest of six; None if missing."""
    parts = [one.figures, one.figures.get("sampled", {}), one.figures.get("energy", {})]
    value = next((part[name] for part in parts if part.get(name) is not None), None)
    return None if value is None else float(np.min(value))


def _judge(subject: Subject, law: SpringSettings) -> Assessment:
    start, conditions = subject.path[0], at_rest(subject)
    compensated, damping, why = _energy(subject, law)
    tau = law_forces(subject, law)
    try:
        p, R, found = rest(subject.robot, tau, start.p, start.R)
    except (ModelError, np.linalg.LinAlgError):
        claim = "the springs of the law do not balance the remaining weight near the reference: stiffen them"
        return Assessment("not proven", claim, conditions, [], {})
    if isinstance(law, PIDSettings):
        J = jacobian(subject.platform, p, R)
        found = found._replace(integral=J.T @ (per_leg(law.ki_N_m_s)[:, None] * J))
    online = isinstance(law, FeedforwardPDSettings) and law.evaluation == "online"
    found = found._replace(observer=subject.observer if online else None)
    sag = leg_lengths(subject.platform, p, R) - leg_lengths(subject.platform, start.p, start.R)
    sag_mm = 1e3 * float(np.abs(sag).max())
    lines, figures, radius = sampled_loop(subject, found, jacobian(subject.platform, p, R))
    met = subject.outside(p, R)
    not_proven = None if met is None else f"it comes to rest outside its limits: {met}"
    grows = None if radius < 1.0 else unstable(subject, radius)
    if damping:
        stiffness = found.stiffness(subject.radius)
        softest, stiffest = stiffness[0], stiffness[-1]
        lines.insert(0, f"stiffness      {softest:.4g} to {stiffest:.4g} N/m where it comes to rest")
        figures["energy"] = {"stiffness_N_m": stiffness.tolist(), "sag_mm": sag_mm}
        if not softest > 0.0:
            not_proven = "the weight is stiffer than the springs: it falls over"
    else:
        slowest, count = found.slowest(), 18 if found.integral.any() else 12
        line = f"eigenvalues    slowest exp({slowest:+.3g} t) of {count}, the weight's stiffness included"
        lines.insert(0, line)
        figures |= {"slowest_eigenvalue_1_s": slowest, "sag_mm": sag_mm}
        if slowest >= 0.0:
            grows = f"{why}: no energy function; an eigenvalue grows as exp({slowest:.3g} t)"
    if grows is None and isinstance(law, PIDSettings):
        held = subject.robot.inverse_dynamics(start.p, start.R, ZERO6, ZERO6)
        if (short := float((np.abs(held) / per_leg(law.integral_limit_N)).max())) > 1.0:
            not_proven = f"the integral cannot carry the weight: {100 * short:.0f} % of integral_limit_N"
    if not_proven is not None:
        return Assessment("not proven", not_proven, conditions, lines, figures)
    if grows is not None:
        return Assessment("unstable", grows, [], lines, figures)
    exact = sag_mm < 1e-3 or compensated
    where = "the set-point" if exact else f"a pose {sag_mm:.3g} mm of leg length off the set-point"
    if damping:
        claim = f"V = t^T M t / 2 + S falls by {damping}: {where} is asymptotically stable (LaSalle)"
        conditions.append(AT_ONCE)
    else:
        rate = -np.log(radius) / subject.axis.period_s
        claim = f"{why}: no energy function; small errors from {where} die out as exp(-{rate:.3g} t)"
        conditions.append("errors are small")
    if online:
        conditions += subject.wrench(law)
    return Assessment("conditional", claim, conditions, lines, figures)


def bench(subject: Subject, law: PDSettings, plant: BenchPlant) -> Assessment:
    """Result of the proof for a PD on six uncoupled legs with their own springs and dampers."""
    K_p, K_v = per_leg(law.kp_N_m), per_leg(law.kv_N_s_m)
    q = leg_lengths(subject.platform, subject.path[0].p, subject.path[0].R)
    linear, cubic = np.asarray(plant.stiffness_N_m), np.asarray(plant.stiffness_N_m3)
    x = cubic_rest(q - plant.rest_length_m, K_p, linear, cubic)
    own = np.diag(linear + 3.0 * cubic * x * x)
    found = Springs(np.eye(6) / plant.mass_kg, np.diag(K_p), np.diag(K_v), own)
    lines, figures, radius = sampled_loop(subject, found)
    if radius >= 1.0:
        return Assessment("unstable", unstable(subject, radius), [], lines, figures)
    claim = (
        "each leg's V = m dq^2 / 2 + K_p e^2 / 2 + its own springs falls by K_v dq^2 + b |dq|^3 and grows "
        "without bound: its rest is globally asymptotically stable (LaSalle)"
    )
    return Assessment("conditional", claim, [*at_rest(subject), AT_ONCE], lines, figures)


def law_forces(subject: Subject, law: SpringSettings) -> Forces:
    """Forces of the law at rest, as a function of the pose; an integral is replaced by holding forces."""
    start, platform = subject.path[0], subject.platform
    context = LawContext(platform, subject.c.platform.leg_spin, subject.axis.period_s)
    built: Law
    held = np.zeros(6)
    if isinstance(law, PIDSettings):
        built, held = law.pd(), subject.robot.inverse_dynamics(start.p, start.R, ZERO6, ZERO6)
    else:
        built = law.build(context)
    tick = np.zeros((), TICK)
    tick["p_d"], tick["R_d"], tick["t_d"] = start.p, start.R, np.nan
    tick["q_d"] = leg_lengths(platform, start.p, start.R)

    joints = platform.base_joints, platform.platform_joints

    def tau(p: Array, R: Array, twist: Array) -> Array:
        J = jacobian_kernel(*joints, p, R)
        for name, value in (("p", p), ("R", R), ("twist", twist), ("J", J), ("dq", J @ twist)):
            tick[name] = value
        tick["q"] = leg_lengths_kernel(*joints, p, R)
        built.effort(tick)
        return np.asarray(held + tick["tau_law"], float)

    return tau


def sampled_loop(
    subject: Subject, found: Springs, J: Array | None = None
) -> tuple[list[str], dict[str, Any], float]:
    """The sampled loop as lines of text and figures, and its largest |z|; J: Jacobian of the leg lengths."""
    radius = found.growth(subject.axis)
    figures: dict[str, Any] = {"sampled": {"largest_pole": radius}}
    line = f"sampled loop   largest |z| {radius:.4f} where it comes to rest, all axes together"
    if radius < 1.0 and (margins := found.margins(subject.axis)) is not None:
        margin, crossover, phase = margins
        figures["sampled"]["delay_margin_ms"] = 1e3 * margin if isfinite(margin) else None
        figures["sampled"]["cross_over_rad_s"] = crossover
        figures["sampled"]["phase_margin_deg"] = phase if isfinite(phase) else None
        figures["sampled"]["gain_margin"] = found.gain_up(subject.axis)
        figures["sampled"]["peak_m_N"] = None if J is None else found.per_force(subject.axis, J)
        line += f"; alone it bears {1e3 * margin:.3g} ms more delay; crosses over at {crossover:.0f} rad/s"
    return [line], figures, radius


def _energy(subject: Subject, law: SpringSettings) -> tuple[bool, str, str]:
    """(weight is compensated exactly, damping term of dV/dt, reason why there is no V if that is empty)."""
    model = law.believed
    if isinstance(law, PIDSettings):
        return False, "", "an integral"
    frozen = {"constant_MG"} if isinstance(law, PDGravitySettings) else {"constant", "constant_MG"}
    if model is not None and model.variant in frozen and not isinstance(law, FeedforwardPDSettings):
        return False, "", "a weight that is frozen while the robot moves has no potential"
    exact = False  # the same forces at every pose; True: those that carry the weight there
    if model is not None and model.variant != "constant" and not isinstance(law, FeedforwardPDSettings):
        variant = "massless_legs" if model.variant == "massless_legs" else "full"
        there = model.model_copy(update={"variant": variant, "frozen_at": None})
        exact = same_weight(subject.robot, subject.believed(there))
    if not isinstance(law, CartesianPDSettings):
        return exact, "dq^T K_v dq", ""
    if law.rotation_error == "vector_difference":
        return False, "", "the stiffness of vector_difference is not symmetric"
    if len(set(law.gains()[0][3:])) > 1:
        return False, "", "three stiffnesses of rotation have an energy to first order only"
    return exact, "t^T K_v t", ""
