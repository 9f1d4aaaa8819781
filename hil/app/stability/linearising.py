"""Assessment of laws that linearise the robot: joint and pose inverse dynamics, without H, robust."""

from math import inf, isfinite, sqrt

import numpy as np

from drivers.arrays import Array
from hil.app.stability.subject import SURVEYED, Inertia, Judged, Subject, Unknown
from hil.app.stability.wording import (
    bound_lines,
    certificate_lines,
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
from hil.stability.error_dynamics import certificate
from hil.stability.prediction import predicting
from hil.stability.reaching import redesign, sliding
from hil.stability.sampled import Sampled, analyse, gains
from hil.stability.ultimate import Ultimate

RobustSettings = SlidingModeSettings | RobustInverseDynamicsSettings


def linear(subject: Subject, law: LawSettings, dynamics: ErrorDynamics) -> Assessment:
    """Judge e'' + K_D e' + K_P e = d as it is sampled, held and late."""
    axes: AxisSpace = "pose" if dynamics.pose else "joint"
    K_P, K_D = dynamics.K_P, dynamics.K_D
    judged = bounded(subject, law, axes, K_P, K_D)
    loop, bound = judged.loop, judged.bound
    lines, figures = describe(loop)
    if not loop.stable:
        return Assessment("unstable", unstable(subject, loop), [], lines, figures)
    conditions = assumed(subject, law)
    if isinstance(bound, str):
        return Assessment("not proven", bound, conditions, lines, figures)
    proof = certificate(bound.gamma * K_P, bound.gamma * K_D)
    more, numbers = bound_lines(judged, axes)
    first, values = certificate_lines(proof)
    lines, figures = first + more + lines, {**values, **numbers, **figures}
    if subject.undisturbed(bound):
        claim = f"at the reference's pose small errors die out, the slowest as exp(-{loop.decay_rate:.3g} t)"
        return Assessment(unless(conditions), claim, conditions, lines, figures)
    claim = f"errors stay below {worst(bound, axes)} along the reference"
    return Assessment("conditional", claim, [*conditions, SURVEYED], lines, figures)


def robust(subject: Subject, law: RobustSettings) -> Assessment:
    """Judge sliding mode and the Lyapunov redesign by reaching condition, layer, and the loop inside it."""
    uncertainty = law.uncertainty
    dynamics = law.error_dynamics()
    linear_P, linear_D, layer = dynamics.K_P, dynamics.K_D, dynamics.layer
    slope = float(np.max(dynamics.slope))
    conditions = assumed(subject, law)
    alpha = uncertainty.model_error
    size = uncertainty.disturbance_m_s2 + alpha * (uncertainty.acceleration_m_s2 or 0.0)
    inertia = Inertia(alpha, alpha, 1.0 - alpha, 1.0 - alpha)
    d, source = np.full(6, size), "section uncertainty"
    judged: Judged | None = None
    if layer > 0.0:
        if subject.nothing:
            judged = bounded(subject, law, "joint", linear_P, linear_D, size, alpha)
        else:
            source = "what is given"
            judged = bounded(subject, law, "joint", linear_P, linear_D)
        if not judged.loop.stable:
            return Assessment("unstable", unstable(subject, judged.loop), [], *describe(judged.loop))
        if isinstance(judged.bound, str):
            return Assessment("not proven", f"with what is stated: {judged.bound}", conditions, [], {})
        if not subject.nothing:
            inertia, d = judged.inertia, np.max([bound.d for _, bound in judged.bounds], axis=0)
    elif not subject.nothing:
        claim = "without a boundary layer nothing but section uncertainty is judged: give boundary_layer_m_s"
        return Assessment("not proven", claim, conditions, [], {})
    inside = inf if judged is None else _inside(judged, slope)
    if isinstance(law, SlidingModeSettings):
        k = law.switching_gain
        name, size = "s", float(d.max())
        within = "while no leg is more than {room} m/s off its rate"
        gamma = inertia.dominance
        found = sliding(slope, k, layer, gamma=gamma, alpha=inertia.alpha, d=size, inside=inside)
    else:
        name, k = "y", law.bound
        within = "while the root of the legs' summed squares is no more than {room} m off"
        size, inside = float(np.linalg.norm(d)), sqrt(6.0) * inside
        K_P, K_D = (float(gain.max()) for gain in law.gains())
        gamma = inertia.definite
        if float(np.min(law.gains()[1])) < K_D or gamma < 0.5:
            claim = (
                "the redesign is proven here for legs of equal gains"
                if gamma >= 0.5
                else f"the robot does {gamma:.2g} of what is asked at worst, and below 0.5 nothing is proven"
            )
            return Assessment("not proven", claim, conditions, [], {})
        found = redesign(K_P, K_D, k, layer, gamma=gamma, alpha=inertia.alpha_2, d=size, inside=inside)
    lines, figures = reaching_lines(found, k, size, gamma, source, name)
    if judged is None:
        conditions.append("a loop without delay: it switches at every tick, and chatters")
    else:
        assert isinstance(judged.bound, Ultimate)
        for more, numbers in (describe(judged.loop), bound_lines(judged, "joint")):
            lines, figures = lines + more, {**figures, **numbers}
    if found.surplus <= 0.0:
        claim = (
            f"{gamma:.3g} x {k:.3g} m/s^2 do not cover {size:.3g} m/s^2 of {source}: {name} need not reach "
            "its layer"
        )
        return Assessment("not proven", claim, conditions, lines, figures)
    if isfinite(found.room):
        conditions.append(f"from outside its layer: {within.format(room=f'{found.room:.3g}')}")
    claim = f"{name} reaches its layer"
    if judged is None or not isinstance(judged.bound, Ultimate):
        return Assessment("conditional", claim, conditions, lines, figures)
    if found.covered:
        claim += " and stays there"
        error = judged.bound.error
    else:
        conditions.append(
            f"{name} may leave its layer of {layer:.3g} m/s up to {found.inside:.3g} m/s, by delay or by "
            "what the error of the model makes of the law's linear part: there the law is no longer linear, "
            "and the bound takes it for linear"
        )
        error = np.maximum(judged.bound.error, found.inside / slope)
    figures["ultimate_bound"] = error.tolist()
    claim += f", errors stay below {1e3 * error.max():.3g} mm of leg length along the reference"
    return Assessment("conditional", claim, [*conditions, SURVEYED], lines, figures)


def _inside(judged: Judged, slope: float) -> float:
    """Return the largest |de + slope e| of a leg that the loop inside its layer comes to, m/s."""
    return max(
        float(loop.peak_gains(slope)[3] * d + late_s)
        for loops, bound in judged.bounds
        for loop, d, late_s in zip(loops, bound.d, bound.late_rate + slope * bound.late, strict=True)
    )


def bounded(
    subject: Subject,
    law: LawSettings,
    axes: AxisSpace,
    K_P: Array,
    K_D: Array,
    d: float = 0.0,
    alpha: float = 0.0,
) -> Judged:
    """Return the loop of a law with these gains, and its bound. d, m/s^2, and alpha: of its uncertainty."""
    assert law.believed is not None
    delay = law.lookahead
    ahead_s = 0.0 if delay is None else 1e-3 * (delay.bus_ms + delay.drive_lag_ms + delay.hold_ms)

    def loops(gain: float) -> list[Sampled]:
        return sampled(subject, law, K_P, K_D, gain)

    return subject.judged(law.believed, axes, loops, ahead_s, Unknown(d, alpha))


def sampled(subject: Subject, law: LawSettings, K_P: Array, K_D: Array, gain: float) -> list[Sampled]:
    """Return the sampled loop of each axis, with the gain that the robot has."""
    axis = subject.axis._replace(gain=gain)
    delay = law.lookahead

    def controller(k_p: float, k_d: float) -> LinearSystem:
        if delay is None:
            return gains(k_p, k_d, axis.period_s)
        return predicting(
            k_p, k_d, axis.period_s,
            bus_s=1e-3 * delay.bus_ms, lag_s=1e-3 * delay.drive_lag_ms, hold_s=1e-3 * delay.hold_ms,
        )  # fmt: skip

    pairs = [(float(p), float(d)) for p, d in zip(K_P, K_D, strict=True)]
    loops = {pair: analyse(axis, controller(*pair)) for pair in set(pairs)}
    return [loops[pair] for pair in pairs]


def assumed(subject: Subject, law: LawSettings) -> list[str]:
    """Return what a law of this family is proven under, beyond what is checked."""
    conditions = []
    if law.lookahead is not None:
        conditions.append("the delays are those of delay_compensation")
    if subject.c.estimation.wrench.source != "none":
        conditions.append("the estimated wrench is right but for the stated load")
    return conditions + subject.unseen
