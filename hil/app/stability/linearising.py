"""Assessment of laws that linearise the robot: joint and pose inverse dynamics, without H, robust."""

from math import isfinite

import numpy as np

from drivers.arrays import Array
from hil.app.stability.subject import Subject
from hil.app.stability.wording import (
    beside,
    bound_lines,
    decay,
    describe,
    reaching_lines,
    unstable,
    worst,
)
from hil.config.axis_model import AxisSpace
from hil.control.law import ErrorDynamics, LawSettings
from hil.control.robust_inverse_dynamics import RobustInverseDynamicsSettings
from hil.control.sliding_mode import SlidingModeSettings
from hil.mathematics.linear_system import LinearSystem
from hil.stability.assessment import Assessment, unless
from hil.stability.error_dynamics import decay_rate
from hil.stability.prediction import predicting
from hil.stability.reaching import redesign, sliding
from hil.stability.sampled import Sampled, analyse, gains
from hil.stability.ultimate import Ultimate, ultimate

RobustSettings = SlidingModeSettings | RobustInverseDynamicsSettings
SURVEYED = "within the bound nothing disturbs by more than at the extremes looked at: surveyed, not enclosed"


def linear(subject: Subject, law: LawSettings, dynamics: ErrorDynamics) -> Assessment:
    """Judge e'' + K_D e' + K_P e = d by its Lyapunov function, and the loop as it is sampled."""
    axes: AxisSpace = "pose" if dynamics.pose else "joint"
    K_P, K_D = dynamics.K_P, dynamics.K_D
    bound = bounded(subject, law, axes, K_P, K_D)
    loop = sampled(subject, law, K_P, K_D, bound if isinstance(bound, Ultimate) else None)
    slowest = min(decay_rate(float(p), float(d)) for p, d in zip(K_P, K_D, strict=True))
    lines, figures = describe(loop)
    if not loop.stable:
        return Assessment("unstable", unstable(subject, loop), [], lines, figures)
    conditions = assumed(subject, law)
    if isinstance(bound, str):
        claim = f"{bound}; with an exact model and no load errors die out as exp(-{slowest:.3g} t)"
        return Assessment("not proven", claim, conditions, lines, figures)
    more, numbers = bound_lines(bound, loop, axes)
    claims = []
    if bound.exact:
        claims.append(f"die out as exp(-{min(decay(bound), loop.decay_rate):.3g} t)")
    if bound.d.max() > 1e-6:
        claims.append(f"stay below {worst(bound, loop, axes)} along the reference{beside(subject)}")
        conditions.append(SURVEYED)
    claim = f"errors {' and '.join(claims) or 'stay bounded'}"
    return Assessment(unless(conditions), claim, conditions, more + lines, {**numbers, **figures})


def robust(subject: Subject, law: RobustSettings) -> Assessment:
    """Judge sliding mode and the Lyapunov redesign by reaching condition, layer, and the loop inside it."""
    uncertainty = law.uncertainty
    dynamics = law.error_dynamics()
    linear_P, linear_D, layer = dynamics.K_P, dynamics.K_D, dynamics.layer
    slope = float(np.max(dynamics.slope))
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
                return Assessment("not proven", f"with what is stated: {bound}", conditions, [], {})
            gamma, d = bound.gamma, bound.d
    inside = (float(linear_P.max()), float(linear_D.max()))
    if isinstance(law, SlidingModeSettings):
        k = law.switching_gain
        name, size, room_unit = "s", float(d.max()), "m/s off their rates"
        found = sliding(slope, k, layer, gamma=gamma, d=size, linear=inside)
    else:
        name, size, room_unit = "y", float(np.linalg.norm(d)), "m off"
        k = law.bound
        K_P, K_D = (float(gain.max()) for gain in law.gains())
        found = redesign(K_P, K_D, k, layer, gamma=gamma, d=size, linear=inside)
    lines, figures = reaching_lines(found, k, size, gamma, source, name)
    if layer == 0.0:
        conditions.append("a loop without delay: it switches at every tick, and chatters")
        loop = None
    else:
        loop = sampled(subject, law, linear_P, linear_D, bound if isinstance(bound, Ultimate) else None)
        more, numbers = describe(loop)
        lines, figures = lines + more, {**figures, **numbers}
        if not loop.stable:
            return Assessment("unstable", unstable(subject, loop), [], lines, figures)
    if found.surplus <= 0.0:
        claim = f"{k:.3g} m/s^2 do not cover {size:.3g} m/s^2 of {source}: {name} need not reach its layer"
        return Assessment("not proven", claim, conditions, lines, figures)
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
    return Assessment(unless(conditions), claim, conditions, lines, figures)


def bounded(subject: Subject, law: LawSettings, axes: AxisSpace, K_P: Array, K_D: Array) -> Ultimate | str:
    """Return the ultimate bound at the worse end of the stated model error, or why there is none."""
    assert law.believed is not None
    found: Ultimate | None = None
    for linearised in subject.linearised(law.believed, axes):
        one = ultimate(linearised, subject.path, K_P, K_D, condition=subject.c.limits.condition)
        if isinstance(one, str):
            return one
        if found is None or one.error.max() > found.error.max():
            found = one
    assert found is not None
    return found


def sampled(subject: Subject, law: LawSettings, K_P: Array, K_D: Array, bound: Ultimate | None) -> Sampled:
    """Return the sampled loop of the axis with the least delay margin, with the gain that the robot has."""
    axis = subject.axis._replace(gain=1.0 if bound is None else bound.gamma)
    delay = law.lookahead

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


def assumed(subject: Subject, law: LawSettings) -> list[str]:
    """Return what a law of this family is proven under, beyond what is checked."""
    conditions = []
    if law.lookahead is not None:
        conditions.append("the delays are those of delay_compensation")
    if subject.c.estimation.wrench.source != "none":
        conditions.append("the estimated wrench is right but for the stated load")
    if subject.c.plant is None:
        conditions.append("the robot is as section platform says, its drives have neither friction nor lag")
    return conditions
