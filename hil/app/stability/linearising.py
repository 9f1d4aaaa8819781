"""Assessment of laws that linearise the robot: joint and pose inverse dynamics, without H."""

from drivers.arrays import Array
from hil.app.stability.judged import Judged, Unknown
from hil.app.stability.subject import SURVEYED, Subject
from hil.app.stability.wording import bound_lines, certificate_lines, describe, unstable, worst
from hil.config.axis_model import AxisSpace
from hil.control.law import ErrorDynamics, LawSettings
from hil.design.stability.assessment import Assessment, unless
from hil.design.stability.prediction import predicting
from hil.design.stability.sampled import Sampled, analyse, gains
from hil.mathematics.linear_system import LinearSystem


def linear(subject: Subject, law: LawSettings, dynamics: ErrorDynamics) -> Assessment:
    """Judge e'' + K_D e' + K_P e = d as it is sampled, held and late."""
    axes: AxisSpace = "pose" if dynamics.pose else "joint"
    K_P, K_D = dynamics.K_P, dynamics.K_D
    judged = bounded(subject, law, axes, K_P, K_D)
    loop, bound = judged.slowest, judged.bound
    lines, figures = describe(judged.every)
    if not loop.stable:
        return Assessment("unstable", unstable(subject, loop), [], lines, figures)
    conditions = assumed(subject, law)
    if isinstance(bound, str):
        return Assessment("not proven", bound, conditions, lines, figures)
    more, numbers = bound_lines(judged, axes)
    first, values = certificate_lines(judged, K_P, K_D)
    lines, figures = first + more + lines, {**values, **numbers, **figures}
    if subject.undisturbed(bound):
        claim = f"at the reference's pose small errors die out, the slowest as exp(-{loop.decay_rate:.3g} t)"
        return Assessment(unless(conditions), claim, conditions, lines, figures)
    claim = f"errors stay below {worst(bound, axes)} along the reference"
    return Assessment("conditional", claim, [*conditions, SURVEYED], lines, figures)


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
    wrench = subject.wrench if law.compensates_wrench else []
    return conditions + wrench + subject.unseen + subject.live
