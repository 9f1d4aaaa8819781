"""Stability of laws with six decoupled axes: inverse dynamics of legs or pose, and designed controllers."""

from drivers.arrays import Array
from hil.app.loop_delay import stated_delay
from hil.app.stability.assessment import Assessment, bound_lines, certificate_lines, describe, unstable
from hil.app.stability.subject import SURVEYED, Subject
from hil.config.axis_model import AxisSpace
from hil.config.linear_controller import LinearController
from hil.config.model import ModelSettings
from hil.control.law import ErrorDynamics, LawSettings
from hil.design.stability.monitor import horizon_s
from hil.design.stability.sampled_loop import Sampled, analyse, gains, predicting, sampled_controller
from hil.design.stability.ultimate import Judged, Ultimate, in_words
from hil.mathematics.linear_system import LinearSystem


def linear(subject: Subject, law: LawSettings, dynamics: ErrorDynamics) -> Assessment:
    """Result of the proof for e'' + K_D e' + K_P e = d with sampling, hold and delay."""
    axes: AxisSpace = "pose" if dynamics.pose else "joint"
    K_P, K_D = dynamics.K_P, dynamics.K_D
    judged = bounded(subject, law, axes, K_P, K_D)
    found = _verdict(subject, judged, axes, assumed(subject, law))
    if found.status == "unstable" or isinstance(judged.bound, str):
        return found
    lines, figures = certificate_lines(judged, K_P, K_D)
    return found._replace(lines=lines + found.lines, figures=figures | found.figures)


def designed(
    subject: Subject, controller: LinearController, model: ModelSettings, conditions: list[str]
) -> Assessment:
    """Result of the proof for a designed controller, by the eigenvalues of the sampled loop.

    The loop has the stated model errors. conditions: assumptions about the law that runs the controller.
    """
    sampled = subject.observing(sampled_controller(controller))

    def loops(gain: float) -> list[Sampled]:
        return [analyse(subject.axis._replace(gain=gain), sampled)] * 6

    judged = subject.judged(model, controller.axes, loops)
    found = _verdict(subject, judged, controller.axes, conditions)
    figures = found.figures | {"axes": controller.axes, "order": len(controller.A)}
    lines = found.lines
    if not isinstance(judged.bound, str) and "uncertainty" in controller.design:
        gain, share = controller.design["axis"]["gain"], controller.design["uncertainty"]["inertia"]
        (least, largest), low, high = judged.inertia.eigenvalues, gain / (1.0 + share), gain / (1.0 - share)
        figures["coupled_axes_covered"] = covered = low <= least and largest <= high
        line = f"coupled axes   Gamma's eigenvalues {least:.3g} to {largest:.3g} are "
        line += "all within" if covered else "not all within"
        lines = [*lines, f"{line} {low:.3g} to {high:.3g}, which the controller was designed for"]
    return found._replace(lines=lines, figures=figures)


def _verdict(subject: Subject, judged: Judged, axes: AxisSpace, conditions: list[str]) -> Assessment:
    loop, bound = judged.slowest, judged.bound
    lines, figures = describe(judged)
    if not loop.stable:
        return Assessment("unstable", unstable(subject, loop.largest), [], lines, figures)
    if not isinstance(bound, Ultimate):
        return Assessment("not proven", bound, conditions, lines, figures)
    more, numbers = bound_lines(judged, bound, axes)
    lines, figures = more + lines, numbers | figures
    if subject.undisturbed(bound):
        claim = f"at the reference's pose small errors die out, the slowest as exp(-{loop.decay_rate:.3g} t)"
        return Assessment("conditional" if conditions else "proven", claim, conditions, lines, figures)
    claim = f"errors stay below {in_words(bound.error, axes)} along the reference"
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
    """Loops of a law with gains K_P, K_D (6,), and error bound; d m/s^2, alpha: the law's own uncertainty."""
    assert law.believed is not None
    delay, period_s = law.lookahead, subject.axis.period_s
    pairs = [(float(p), float(d)) for p, d in zip(K_P, K_D, strict=True)]

    def controller(k_p: float, k_d: float) -> LinearSystem:
        if delay is None:
            return subject.observing(gains(k_p, k_d, period_s))
        bus_s, lag_s, hold_s = 1e-3 * delay.bus_ms, 1e-3 * delay.drive_lag_ms, 1e-3 * delay.hold_ms
        delays = {"bus_s": bus_s, "lag_s": lag_s, "hold_s": hold_s}
        observes = subject.observer is not None
        return subject.observing(predicting(k_p, k_d, period_s, **delays, estimated=observes))

    def loops(gain: float) -> list[Sampled]:
        found = {pair: analyse(subject.axis._replace(gain=gain), controller(*pair)) for pair in set(pairs)}
        return [found[pair] for pair in pairs]

    return subject.judged(law.believed, axes, loops, horizon_s(delay), d, alpha)


def assumed(subject: Subject, law: LawSettings) -> list[str]:
    """Assumptions of a proof for laws with decoupled axes, in addition to the checked conditions."""
    conditions = []
    if stated_delay(subject.c) is not None:
        section = "estimation.wrench" if law.lookahead is None else "delay_compensation"
        conditions.append(f"the delays are those of {section}")
    wrench = subject.wrench(law) if law.compensates_wrench else []
    return conditions + wrench + subject.unseen + subject.live
