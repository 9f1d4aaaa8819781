"""Verdicts on laws that linearise the robot: inverse dynamics in joint and pose space, without H, robust."""

from __future__ import annotations

from math import inf, isfinite

import numpy as np

from drivers.arrays import Array
from hil.app.stability.subject import Subject
from hil.app.stability.wording import (
    Axes,
    beside,
    bound_lines,
    decay,
    describe,
    reaching_lines,
    unstable,
    worst,
)
from hil.config import (
    InverseDynamicsSettings,
    ModelBasedSettings,
    PartialLinearisationSettings,
    PoseInverseDynamicsSettings,
    RobustInverseDynamicsSettings,
    SlidingModeSettings,
)
from hil.control.law import error_gains
from hil.mathematics.linear_system import LinearSystem
from hil.stability.disturbance import Linearised
from hil.stability.error_dynamics import decay_rate
from hil.stability.prediction import predicting
from hil.stability.reaching import redesign, sliding
from hil.stability.sampled import Sampled, analyse, gains
from hil.stability.ultimate import Ultimate, ultimate
from hil.stability.verdict import Verdict, unless

LinearSettings = InverseDynamicsSettings | PartialLinearisationSettings | PoseInverseDynamicsSettings
RobustSettings = SlidingModeSettings | RobustInverseDynamicsSettings
SURVEYED = "within the bound nothing disturbs by more than at the extremes looked at: surveyed, not enclosed"


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
        conditions.append(SURVEYED)
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
    lines, figures = reaching_lines(found, k, size, gamma, source, name)
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
        conditions.append(SURVEYED)
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
