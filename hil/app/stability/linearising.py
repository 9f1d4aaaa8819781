"""Verdicts on laws that linearise the robot: inverse dynamics in joint and pose space, without H, robust.

Rule of the room: the theorems are in `hil.stability`; here they meet the settings of a law, and become words.
"""

from __future__ import annotations

from math import inf, isfinite
from typing import Any, Literal

import numpy as np

from hil.app.stability.subject import Subject
from hil.config import (
    InverseDynamicsSettings,
    ModelBasedSettings,
    PartialLinearisationSettings,
    PoseInverseDynamicsSettings,
    RobustInverseDynamicsSettings,
    SlidingModeSettings,
)
from hil.control.law import error_gains
from hil.linear_system import LinearSystem
from hil.signals import Array
from hil.stability.disturbance import Linearised
from hil.stability.error_dynamics import decay_rate
from hil.stability.prediction import predicting
from hil.stability.reaching import Reaching, redesign, sliding
from hil.stability.sampled import Sampled, analyse, gains
from hil.stability.ultimate import Ultimate, ultimate
from hil.stability.verdict import Verdict, unless

Axes = Literal["joint", "pose"]
LinearSettings = InverseDynamicsSettings | PartialLinearisationSettings | PoseInverseDynamicsSettings
RobustSettings = SlidingModeSettings | RobustInverseDynamicsSettings


def linear(subject: Subject, law: LinearSettings) -> Verdict:
    """Judge e'' + K_D e' + K_P e = d by its Lyapunov function, and the loop as it is sampled."""
    axes: Axes = "pose" if isinstance(law, PoseInverseDynamicsSettings) else "joint"
    K_P, K_D = error_gains(law.wn_rad_s, law.damping_ratio)
    bound = bounded(subject, law, axes, K_P, K_D)
    loop = sampled(subject, law, K_P, K_D, bound if isinstance(bound, Ultimate) else None)
    slowest = min(decay_rate(float(p), float(d)) for p, d in zip(K_P, K_D, strict=True))
    lines, figures = describe(loop)
    if not loop.stable:
        return Verdict("unstable", unstable(subject, loop), [], lines, figures)
    conditions = assumed(subject, law)
    if isinstance(bound, str):
        claim = f"{bound}; with an exact model and no load errors die out as exp(-{slowest:.3g} t)"
        return Verdict("not proven", claim, conditions, lines, figures)
    more, numbers = bound_lines(bound, loop, axes)
    claims = []
    if bound.exact:
        claims.append(f"die out as exp(-{min(decay(bound), loop.decay_rate):.3g} t)")
    if bound.d.max() > 1e-6:
        claims.append(f"stay below {worst(bound, loop, axes)} along the reference{beside(subject)}")
    claim = f"errors {' and '.join(claims) or 'stay bounded'}"
    return Verdict(unless(conditions), claim, conditions, more + lines, {**numbers, **figures})


def robust(subject: Subject, law: RobustSettings) -> Verdict:
    """Judge sliding mode and the Lyapunov redesign by reaching condition, layer, and the loop inside it."""
    uncertainty = law.uncertainty
    if isinstance(law, SlidingModeSettings):
        slope, k, layer = law.lambda_rad_s, law.switching_gain, law.boundary_layer
        linear_P, linear_D = (np.full(6, gain) for gain in law.linear_gains)
        nominal_P = nominal_D = np.zeros(6)
    else:
        nominal_P, nominal_D = error_gains(law.wn_rad_s, law.damping_ratio)
        slope, k, layer = float(nominal_D.max()) / 2.0, law.bound, law.boundary_layer_m_s
        steepness = k / layer if layer > 0.0 else inf
        linear_P, linear_D = nominal_P + steepness * nominal_D / 2.0, nominal_D + steepness
    conditions = assumed(subject, law)
    alpha = uncertainty.model_error
    d_stated = uncertainty.disturbance_m_s2 + alpha * (uncertainty.acceleration_m_s2 or 0.0)
    gamma, d = 1.0 - alpha, np.full(6, d_stated)
    source = "section uncertainty"
    bound: Ultimate | str | None = None
    if layer > 0.0:
        bound = bounded(subject, law, "joint", linear_P, linear_D)
        if not subject.stated.nothing:
            source = "the load and model error given"
            if isinstance(bound, str):
                return Verdict("not proven", f"with what is stated: {bound}", conditions, [], {})
            gamma, d = bound.gamma, bound.d
    inside = (float(linear_P.max()), float(linear_D.max()))
    if isinstance(law, SlidingModeSettings):
        name, size, room_unit = "s", float(d.max()), "m/s off their rates"
        found = sliding(slope, k, layer, gamma=gamma, d=size, linear=inside)
    else:
        name, size, room_unit = "y", float(np.linalg.norm(d)), "m off"
        stiffest = float(nominal_P.max()), float(nominal_D.max())
        found = redesign(*stiffest, k, layer, gamma=gamma, d=size, linear=inside)
    lines, figures = _reaching_lines(found, k, size, gamma, source, name)
    if layer == 0.0:
        conditions.append("a loop without delay: it switches at every tick, and chatters")
        loop = None
    else:
        loop = sampled(subject, law, linear_P, linear_D, bound if isinstance(bound, Ultimate) else None)
        more, numbers = describe(loop)
        lines, figures = lines + more, {**figures, **numbers}
        if not loop.stable:
            return Verdict("unstable", unstable(subject, loop), [], lines, figures)
    if found.surplus <= 0.0:
        claim = f"{k:.3g} m/s^2 do not cover {size:.3g} m/s^2 of {source}: {name} need not reach its layer"
        return Verdict("not proven", claim, conditions, lines, figures)
    if isfinite(found.room):
        conditions.append(f"from outside its layer: legs no more than {found.room:.3g} {room_unit}")
    if not found.covered:
        conditions.append(
            f"{name} may leave its layer of {layer:.3g} m/s up to {found.inside:.3g} m/s, by what the error "
            "of the model makes of the law's linear part: keep more in reserve"
        )
    claim = f"{name} reaches its layer and stays there"
    if isinstance(bound, Ultimate) and loop is not None and not subject.stated.nothing:
        more, numbers = bound_lines(bound, loop, "joint")
        lines, figures = more + lines, {**numbers, **figures}
        claim += f", errors stay below {worst(bound, loop, 'joint')} along the reference{beside(subject)}"
    elif layer > 0.0:
        claim += f", errors stay below {1e3 * layer / slope:.3g} mm"
    return Verdict(unless(conditions), claim, conditions, lines, figures)


def bounded(
    subject: Subject, law: LinearSettings | ModelBasedSettings, axes: Axes, K_P: Array, K_D: Array
) -> Ultimate | str:
    """Return the ultimate bound at the worse end of the stated model error, or why there is none."""
    alpha = subject.stated.model_error
    found: Ultimate | None = None
    for scale in (1.0,) if alpha == 0.0 else (1.0 - alpha, 1.0 + alpha):
        believed = subject.believed(law.model, scale)
        linearised = Linearised(
            subject.robot, believed, axes, subject.stated.load, subject.friction(law.model)
        )
        one = ultimate(linearised, subject.path, K_P, K_D, condition=subject.c.limits.condition)
        if isinstance(one, str):
            return one
        if found is None or one.error.max() > found.error.max():
            found = one
    assert found is not None
    return found


def sampled(
    subject: Subject, law: LinearSettings | ModelBasedSettings, K_P: Array, K_D: Array, bound: Ultimate | None
) -> Sampled:
    """Return the sampled loop of the axis with the least delay margin, with the gain that the robot has."""
    axis = subject.axis._replace(gain=1.0 if bound is None else bound.gamma)
    delay = law.delay_compensation if isinstance(law, ModelBasedSettings) else None

    def controller(k_p: float, k_d: float) -> LinearSystem:
        if delay is None:
            return gains(k_p, k_d, axis.period_s)
        return predicting(
            k_p, k_d, axis.period_s,
            bus_s=1e-3 * delay.bus_ms, lag_s=1e-3 * delay.drive_lag_ms, hold_s=1e-3 * delay.hold_ms,
        )  # fmt: skip

    pairs = sorted({(float(p), float(d)) for p, d in zip(K_P, K_D, strict=True)})
    loops = [analyse(axis, controller(*pair)) for pair in pairs]
    return min(loops, key=lambda loop: -1.0 if loop.margins is None else loop.margins.delay_s)


def assumed(subject: Subject, law: LinearSettings | ModelBasedSettings) -> list[str]:
    """Return what a law of this family is proven under, beyond what is checked."""
    conditions = []
    delay = law.delay_compensation if isinstance(law, ModelBasedSettings) else None
    if delay is not None:
        conditions.append("the delays are those of delay_compensation")
    if subject.c.estimation.wrench.source != "none":
        conditions.append("the estimated wrench is right but for the stated load")
    if subject.c.plant is None:
        conditions.append("the robot is as section platform says, its drives have neither friction nor lag")
    return conditions


def beside(subject: Subject) -> str:
    """Return what the bound of a moving reference does not hold: it is that of a law without sampling."""
    return "" if subject.rest else ", beside what its sampling costs"


def describe(loop: Sampled) -> tuple[list[str], dict[str, Any]]:
    """Return the sampled loop in words and figures."""
    largest = float(np.abs(loop.poles).max())
    figures: dict[str, Any] = {"sampled": {"largest_pole": largest, "decay_rate_1_s": float(loop.decay_rate)}}
    margins = loop.margins
    if margins is None:
        return [f"sampled loop   unstable, largest |z| {largest:.4f}"], figures
    figures["sampled"] |= {
        "phase_margin_deg": margins.phase_deg,
        "delay_margin_ms": 1e3 * margins.delay_s,
        "gain_margin": margins.gain_up,
        "cross_over_rad_s": margins.crossover_rad_s,
        "peak_gain_s2": loop.peak_gain,
    }
    return [
        f"sampled loop   largest |z| {largest:.4f}, slowest mode exp(-{loop.decay_rate:.3g} t)",
        (
            f"margins        phase {margins.phase_deg:.0f} deg, gain x {margins.gain_up:.3g}, further delay "
            f"{1e3 * margins.delay_s:.3g} ms; crosses over at {margins.crossover_rad_s:.0f} rad/s"
        ),
    ], figures


def unstable(subject: Subject, loop: Sampled) -> str:
    """Say that the sampled loop is not stable."""
    return (
        f"the sampled loop has an eigenvalue of magnitude {np.abs(loop.poles).max():.4g} with "
        f"{subject.trade}: lower the gains or the delay"
    )


def decay(bound: Ultimate) -> float:
    """Return the slowest decay of the six axes with the gains that the robot has, 1/s."""
    proved = bound.certificate
    return min(decay_rate(float(p), float(d)) for p, d in zip(proved.K_P, proved.K_D, strict=True))


def _late(bound: Ultimate, loop: Sampled) -> float:
    """Return by how much delay and sampling raise the bound: where the late loop's peak gain is above it."""
    return max(1.0, loop.peak_gain / float(bound.certificate.error_gain().min()))


def worst(bound: Ultimate, loop: Sampled, axes: Axes) -> str:
    """Return the ultimate bound in words."""
    error = _late(bound, loop) * bound.error
    if axes == "joint":
        return f"{1e3 * error.max():.3g} mm of leg length"
    return f"{1e3 * error[:3].max():.3g} mm and {np.degrees(error[3:].max()):.3g} deg"


def bound_lines(bound: Ultimate, loop: Sampled, axes: Axes) -> tuple[list[str], dict[str, Any]]:
    """Return certificate and bound in words and figures."""
    proved = bound.certificate
    late = _late(bound, loop)
    P = proved.P[0]
    figures = {
        "K_P_1_s2": proved.K_P.tolist(),
        "K_D_1_s": proved.K_D.tolist(),
        "alpha_1_s": proved.alpha.tolist(),
        "P": proved.P.tolist(),
        "decay_rate_1_s": decay(bound),
        "axes": axes,
        "gamma": bound.gamma,
        "disturbance": bound.d.tolist(),
        "ultimate_bound": (late * bound.error).tolist(),
        "ultimate_rate_bound": (late * bound.rate).tolist(),
        "least_bound": bound.least_error.tolist(),
        "condition_max": bound.condition,
    }
    lines = [
        (
            f"V of axis 0    {P[0, 0]:.4g} e^2 + {2 * P[0, 1]:.4g} e de + {P[1, 1]:.4g} de^2, "
            f"dV/dt <= -{2 * proved.alpha[0]:.3g} (V - d^2)"
        ),
        (
            f"gains          K_P {_range(proved.K_P)} 1/s^2, K_D {_range(proved.K_D)} 1/s; without delay "
            f"errors die out as exp(-{decay(bound):.3g} t)"
        ),
        f"singularity    condition of J {bound.condition:.2f} at most, along the reference and in the bound",
    ]
    if bound.d.max() > 1e-6:
        if axes == "joint":
            lines.append(
                f"disturbance    {bound.d.max():.3g} m/s^2 of a leg: |e| <= {worst(bound, loop, axes)}; "
                f"some disturbance gets to {1e3 * bound.least_error.max():.3g} mm"
            )
        else:
            lines.append(
                f"disturbance    {bound.d[:3].max():.3g} m/s^2, {bound.d[3:].max():.3g} rad/s^2: "
                f"|e| <= {worst(bound, loop, axes)}"
            )
        if late > 1.0:
            lines.append(f"delay          raises the bound by {100 * (late - 1):.0f} %, included")
    return lines, figures


def _reaching_lines(
    found: Reaching, k: float, d: float, gamma: float, source: str, name: str
) -> tuple[list[str], dict[str, Any]]:
    legs = "a leg" if name == "s" else "all legs"
    figures = {
        "reaching": {
            "gain_m_s2": k,
            "disturbance_m_s2": d,
            "gamma": gamma,
            "surplus_m_s2": found.surplus,
            "layer_m_s": found.layer,
            "inside_m_s": found.inside if isfinite(found.inside) else None,
        }
    }
    lines = [
        (
            f"reaching       {gamma:.3g} x {k:.3g} m/s^2 against {d:.3g} m/s^2 of {legs} ({source}): "
            f"{found.surplus:.3g} m/s^2 to spare"
        )
    ]
    if found.surplus > 0.0:
        seconds = found.time_s(found.layer + 1.0)
        lines.append(f"reach time     {seconds:.3g} s for each m/s of |{name}| outside the layer")
        figures["reaching"]["reach_time_s_per_m_s"] = seconds
    if found.layer > 0.0:
        lines.append(f"layer          |{name}| stays below {found.inside:.3g} of {found.layer:.3g} m/s")
    return lines, figures


def _range(x: Array) -> str:
    low, high = float(x.min()), float(x.max())
    return f"{low:.4g}" if high - low <= 1e-9 * high else f"{low:.4g} to {high:.4g}"
