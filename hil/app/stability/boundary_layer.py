"""Stability of sliding mode and Lyapunov redesign: reaching condition, boundary layer, loop within it."""

from math import isfinite, sqrt
from typing import Any

import numpy as np

from drivers.arrays import Array
from hil.app.stability.assessment import Assessment, bound_lines, describe, unstable
from hil.app.stability.axes import assumed, bounded
from hil.app.stability.subject import SURVEYED, Subject
from hil.control.robust_inverse_dynamics import RobustInverseDynamicsSettings
from hil.control.sliding_mode import SlidingModeSettings
from hil.design.stability.disturbance import Inertia
from hil.design.stability.reaching import Reaching, redesign, sliding
from hil.design.stability.sampled_loop import of_each
from hil.design.stability.ultimate import Judged

RobustSettings = SlidingModeSettings | RobustInverseDynamicsSettings


def robust(subject: Subject, law: RobustSettings) -> Assessment:
    """Result of the proof for sliding mode or Lyapunov redesign: reaching, layer, and loop within it."""
    dynamics, name = law.error_dynamics(), "s" if isinstance(law, SlidingModeSettings) else "y"
    conditions = assumed(subject, law)
    if law.lookahead is not None:
        conditions.append(f"the {name} that the law predicts is no larger than the one measured")
    if subject.observer is not None:
        conditions.append("outside its layer the estimated wrench is right")
    if dynamics.layer <= 0.0:
        claim = "without a boundary layer it switches at every tick, and chatters: give boundary_layer_m_s"
        return Assessment("not proven", claim, conditions, [], {})
    u, size, alpha = law.uncertainty, 0.0, 0.0
    if subject.nothing:  # else the stated unknowns are the disturbance
        size, alpha = u.disturbance_m_s2 + u.model_error * (u.acceleration_m_s2 or 0.0), u.model_error
    judged = bounded(subject, law, "joint", dynamics.K_P, dynamics.K_D, size, alpha)
    if not judged.slowest.stable:
        return Assessment("unstable", unstable(subject, judged.slowest.largest), [], *describe(judged))
    if isinstance(judged.bound, str):
        claim = f"with the stated uncertainty: {judged.bound}"
        return Assessment("not proven", claim, conditions, *describe(judged))
    if subject.nothing:
        inertia, d = Inertia(alpha, alpha, 1.0 - alpha, 1.0 - alpha), np.full(6, size)
    else:
        inertia, d = judged.inertia, np.max([b.d for _, b in judged.bounds], axis=0)
    slope = float(np.max(dynamics.slope))
    found = _reaching(subject, law, inertia, d, _inside(subject, judged, slope))
    if isinstance(found, str):
        return Assessment("not proven", found, conditions, *describe(judged))
    reaching, short, lines, figures = found
    for more, numbers in (describe(judged), bound_lines(judged, judged.bound, "joint")):
        lines, figures = lines + more, {**figures, **numbers}
    if reaching.surplus <= 0.0:
        return Assessment(
            "not proven", f"{short}: {name} need not reach its layer", conditions, lines, figures
        )
    if isfinite(reaching.room):
        within = f"while no leg is more than {reaching.room:.3g} m/s off its rate"
        if name == "y":
            within = f"while the root of the legs' summed squares is no more than {reaching.room:.3g} m off"
        conditions.append(f"from outside its layer: {within}")
    error, claim = judged.bound.error, f"{name} reaches its layer"
    if reaching.covered:
        claim += " and stays there"
    else:
        conditions.append(
            f"{name} may leave its layer of {reaching.layer:.3g} m/s up to {reaching.inside:.3g} m/s, by "
            "delay or by model errors in the law's linear part: there the law is not "
            "linear, but the bound assumes that it is"
        )
        error = np.maximum(error, reaching.inside / slope)
    figures["ultimate_bound"] = error.tolist()
    claim += f", errors stay below {1e3 * error.max():.3g} mm of leg length along the reference"
    return Assessment("conditional", claim, [*conditions, SURVEYED], lines, figures)


def _inside(subject: Subject, judged: Judged, slope: float) -> float:
    """Largest |de + slope e| of a leg that is measured in the linear loop, m/s; slope: 1/s."""
    step, rate_step = float(subject.drives.length.max()), float(subject.drives.rate.max())
    largest = 0.0
    for loops, bound in judged.bounds:
        peaks = np.array(of_each(loops, lambda loop: loop.peak_gains(slope)))[:, 3]
        by_length = np.array(of_each(loops, lambda loop: loop.measured_gains(slope)))[:, 3]
        by_rate = np.array(of_each(loops, lambda loop: loop.measured_gains(slope, rate=True)))[:, 3]
        read = (by_length + slope) * step + (by_rate + 1.0) * rate_step
        late_s = bound.late_rate + slope * bound.late
        largest = max(largest, float(np.max(peaks * bound.d + late_s + read)))
    return largest


def _reaching(
    subject: Subject, law: RobustSettings, inertia: Inertia, d: Array, inside: float
) -> tuple[Reaching, str, list[str], dict[str, Any]] | str:
    """(result, text on the uncovered disturbance, lines, figures) of the reaching condition; or an error.

    d (6,): m/s^2, largest disturbance of each leg. inside: m/s, largest sliding variable of a leg.
    """
    dynamics = law.error_dynamics()
    if isinstance(law, SlidingModeSettings):
        name, legs, linear, k = "s", "a leg", "", law.switching_gain
        gamma, size, slope = inertia.dominance, float(d.max()), float(np.max(dynamics.slope))
        found = sliding(slope, k, dynamics.layer, gamma=gamma, alpha=inertia.alpha, d=size, inside=inside)
    else:
        name, legs, linear, k = "y", "all legs", " with its linear part", law.bound
        gamma, size = inertia.definite, float(np.linalg.norm(d))
        K_P, K_D = (float(gain.max()) for gain in law.gains())
        if gamma < 0.5:
            return f"the robot realises {gamma:.2g} of an acceleration at worst; below 0.5 there is no proof"
        if float(np.min(law.gains()[1])) < K_D:
            return "the redesign is proven here for legs of equal gains"
        inside *= sqrt(6.0)
        found = redesign(
            K_P, K_D, k, dynamics.layer, gamma=gamma, alpha=inertia.alpha_2, d=size, inside=inside
        )
    figures = {
        "gain_m_s2": k,
        "disturbance_m_s2": size,
        "gamma": gamma,
        "surplus_m_s2": found.surplus,
        "layer_m_s": found.layer,
        "inside_m_s": found.inside,
    }
    source = "section uncertainty" if subject.nothing else "what is given"
    first = f"reaching       {gamma:.3g} x {k:.3g} m/s^2 against {size:.3g} m/s^2 of {legs} ({source}): "
    lines = [f"{first}{found.surplus:.3g} m/s^2 to spare{linear}"]
    if found.surplus > 0.0:
        seconds = found.time_s(found.layer + 1.0)
        lines.append(f"reach time     {seconds:.3g} s for each m/s of |{name}| outside the layer")
        figures["reach_time_s_per_m_s"] = seconds
    lines.append(f"layer          |{name}| stays below {found.inside:.3g} of {found.layer:.3g} m/s")
    short = f"{gamma:.3g} x {k:.3g} m/s^2 do not cover {size:.3g} m/s^2 of {source}"
    return found, short, lines, {"reaching": figures}
