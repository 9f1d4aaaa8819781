"""Result of a stability proof, and its lines and figures for laws that linearise the robot."""

from typing import Any, Literal, NamedTuple

from drivers.arrays import Array
from hil.app.stability.subject import Subject
from hil.config.axis_model import AxisSpace
from hil.design.stability.error_dynamics import certificate, decay_rate
from hil.design.stability.ultimate import Judged, Ultimate, in_words

Status = Literal["proven", "conditional", "not proven", "unstable"]


class Assessment(NamedTuple):
    """Result of the stability proof of one law in one configuration."""

    status: Status
    """`conditional`: proven if all of `conditions` hold, which are not checked. `unstable`: refuted."""
    claim: str
    """The proven statement, or the reason why there is no proof."""
    conditions: list[str]
    lines: list[str]
    """Figures with their units, for people."""
    figures: dict[str, Any]
    """The figures as plain values."""
    premises: list[str] = []
    """Timing and limits that the claim assumes; a run that violates one warns, or its drives end it."""


NEGLIGIBLE = 0.01
"""Share of a disturbance below which a part of it is not shown."""


def describe(judged: Judged) -> tuple[list[str], dict[str, Any]]:
    """Sampled loops of the axes as lines of text and figures; each figure is the worst of all axes."""
    slowest, loops = judged.slowest, judged.every
    largest, rate = slowest.largest, slowest.decay_rate
    figures: dict[str, Any] = {"sampled": {"largest_pole": largest, "decay_rate_1_s": rate}}
    margins = [loop.margins for loop in loops if loop.margins is not None]
    if not slowest.stable or not margins:
        return [f"sampled loop   unstable, largest |z| {largest:.4f}"], figures
    phase, gain = min(one.phase_deg for one in margins), min(one.gain_up for one in margins)
    delay, crossover = min(one.delay_s for one in margins), max(one.crossover_rad_s for one in margins)
    figures["sampled"] |= {
        "phase_margin_deg": phase,
        "delay_margin_ms": 1e3 * delay,
        "gain_margin": gain,
        "cross_over_rad_s": crossover,
        "peak_gain_s2": max(float(loop.peak_gains()[0]) for loop in loops),
    }
    fastest = ", the fastest axis" if len({one.crossover_rad_s for one in margins}) > 1 else ""
    return [
        f"sampled loop   largest |z| {largest:.4f}, slowest mode exp(-{rate:.3g} t)",
        (
            f"margins        phase {phase:.0f} deg, gain x {gain:.3g}, delay "
            f"{1e3 * delay:.3g} ms of the loop alone; crosses over at {crossover:.0f} rad/s{fastest}"
        ),
    ], figures


def unstable(subject: Subject, radius: float) -> str:
    """Message about an unstable sampled loop."""
    lag = "" if subject.axis.lag_s > 0.0 else ", no lag of the drives known"
    return (
        f"the sampled loop has an eigenvalue of magnitude {radius:.4g} with "
        f"{1e3 * subject.axis.transport_s:g} ms from measurement to force{lag}: lower the gains or the delay"
    )


def certificate_lines(judged: Judged, K_P: Array, K_D: Array) -> tuple[list[str], dict[str, Any]]:
    """Lyapunov function of the loop without sampling and delay, as lines of text and figures.

    K_P (6,) 1/s^2 and K_D (6,) 1/s: the gains of the law; the axes have gamma times these.
    """
    assert isinstance(judged.bound, Ultimate)
    proved = certificate(judged.bound.gamma * K_P, judged.bound.gamma * K_D)
    P = proved.P[0]
    pairs = [(float(p), float(d)) for p, d in zip(K_P, K_D, strict=True)]
    slowest = min(decay_rate(b.gamma * p, b.gamma * d) for _, b in judged.bounds for p, d in pairs)
    without = "without delay" if all(b.exact for _, b in judged.bounds) else "without delay and coupling"
    figures = {
        "K_P_1_s2": proved.K_P.tolist(),
        "K_D_1_s": proved.K_D.tolist(),
        "alpha_1_s": proved.alpha.tolist(),
        "P": proved.P.tolist(),
        "decay_rate_1_s": slowest,
    }
    lines = [
        (
            f"V of axis 0    {P[0, 0]:.4g} e^2 + {2 * P[0, 1]:.4g} e de + {P[1, 1]:.4g} de^2, "
            f"dV/dt <= -{2 * proved.alpha[0]:.3g} (V - d^2)"
        ),
        (
            f"gains          K_P {_range(proved.K_P)} 1/s^2, K_D {_range(proved.K_D)} 1/s; {without} "
            f"errors die out as exp(-{slowest:.3g} t)"
        ),
    ]
    return lines, figures


def bound_lines(judged: Judged, bound: Ultimate, axes: AxisSpace) -> tuple[list[str], dict[str, Any]]:
    """Ultimate bound of the error, and the inertia error's part in it, as lines of text and figures."""
    inertia = judged.inertia
    least, largest = inertia.eigenvalues
    figures = {
        "alpha": inertia.alpha,
        "gamma_eigenvalues": list(inertia.eigenvalues),
        "axes": axes,
        "gamma": bound.gamma,
        "disturbance": bound.d.tolist(),
        "ultimate_bound": bound.error.tolist(),
        "ultimate_rate_bound": bound.rate.tolist(),
        "pushed": bound.pushed.tolist(),
        "drives": bound.drives.tolist(),
        "late": bound.late.tolist(),
        "old_feedback": bound.aged.tolist(),
        "condition_max": bound.condition,
    }
    size, unit = f"{bound.d.max():.3g} m/s^2 of a leg", "m/s^2"
    if axes == "pose":
        size, unit = f"{bound.d[:3].max():.3g} m/s^2, {bound.d[3:].max():.3g} rad/s^2", "m/s^2 or rad/s^2"
    late, error = in_words(bound.late, axes), in_words(bound.error, axes)
    alpha, part = inertia.alpha, "of the disturbance are"
    drives, pushed = f"{bound.drives.max():.3g} {unit} {part}", f"{bound.pushed.max():.3g} {unit} {part}"
    shown = (
        (True, f"singularity    condition of J {bound.condition:.2f} at most, also within the bound"),
        (
            alpha > 1e-6,
            f"inertia        |Gamma - I| {alpha:.3g}: share of an acceleration that is missed, or couples",
        ),
        (alpha > 1e-6, f"               eigenvalues of Gamma {least:.3g} to {largest:.3g}"),
        (bound.aged.max() > 0.0, f"old feedback   makes {in_words(bound.aged, axes)} of the bound"),
        (bound.late.max() > 0.0, f"delay          makes {late} of the bound, along the reference"),
        (bound.d.max() > 1e-6, f"disturbance    {size}: with the rest |e| <= {error}{judged.carried}"),
        (
            bound.drives.max() > NEGLIGIBLE * bound.d.max(),
            f"drives         {drives} force resolution, and losses of a transmission on reversal",
        ),
        (
            bound.pushed.max() > 1e-6,
            f"pushes         {pushed} probe pushes of safety, on legs at rest while others stray",
        ),
    )
    return [line for counts, line in shown if counts], figures


def _range(x: Array) -> str:
    low, high = float(x.min()), float(x.max())
    return f"{low:.4g}" if high - low <= 1e-9 * high else f"{low:.4g} to {high:.4g}"
