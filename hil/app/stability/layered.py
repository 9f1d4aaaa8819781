"""Assessment of sliding mode and the Lyapunov redesign: reaching, layer, the loop in it and beyond."""

from math import isfinite, sqrt
from typing import Any, NamedTuple

import numpy as np

from drivers.arrays import Array
from hil.app.stability.axes import assumed, bounded
from hil.app.stability.subject import SURVEYED, Subject
from hil.app.stability.wording import Assessment, bound_lines, describe, reaching_lines, unstable
from hil.control.robust_inverse_dynamics import RobustInverseDynamicsSettings
from hil.control.sliding_mode import SlidingModeSettings
from hil.design.stability.disturbance import Inertia
from hil.design.stability.reaching import Reaching, Sector, redesign, sliding
from hil.design.stability.sampled import of_each
from hil.design.stability.ultimate import Judged, Ultimate

RobustSettings = SlidingModeSettings | RobustInverseDynamicsSettings

SECTORS = (1.1, 1.2, 1.35, 1.5, 1.75, 2.0, 2.5, 3.0)
"""Times that the gain of a layer is lowered by, where it may be left."""
HALVINGS = 4
"""Of the step between the last of them that does not close and the first that does."""


class Layered(NamedTuple):
    """A law with a boundary layer, and what is stated of what its model does not know."""

    subject: Subject
    law: RobustSettings

    @property
    def name(self) -> str:
        """Its sliding variable."""
        return "s" if isinstance(self.law, SlidingModeSettings) else "y"

    @property
    def source(self) -> str:
        """Where what disturbs it is stated."""
        return "section uncertainty" if self.subject.nothing else "what is given"

    @property
    def k(self) -> float:
        """The largest correction, m/s^2: of a leg, or of all."""
        return self.law.switching_gain if isinstance(self.law, SlidingModeSettings) else self.law.bound

    @property
    def slope(self) -> float:
        """1/s, of e in its sliding variable."""
        return float(np.max(self.law.error_dynamics().slope))

    @property
    def stated(self) -> tuple[float, float]:
        """Disturbance of a leg in m/s^2, and alpha, of section uncertainty, where nothing else is stated."""
        u = self.law.uncertainty
        if not self.subject.nothing:
            return 0.0, 0.0
        return u.disturbance_m_s2 + u.model_error * (u.acceleration_m_s2 or 0.0), u.model_error

    def bounded(self, weaker: float = 0.0, rest: float = 0.0) -> Judged:
        """Return loop and bound where the law is linear, by 1/s less than in its layer; rest: m/s^2 more."""
        dynamics, (d, alpha) = self.law.error_dynamics(), self.stated
        K_P, K_D = dynamics.K_P - weaker * dynamics.slope, dynamics.K_D - weaker
        return bounded(self.subject, self.law, "joint", K_P, K_D, d + rest, alpha)

    def inside(self, judged: Judged) -> float:
        """Return the largest |s| of a leg, or |y| of all, as measured, of the linear loop, m/s."""
        slope, drives = self.slope, self.subject.drives
        step, rate_step = float(drives.length.max()), float(drives.rate.max())
        largest = 0.0
        for loops, bound in judged.bounds:
            peaks, by_length, by_rate = (
                np.array(of_each(loops, figures))[:, 3]
                for figures in (
                    lambda loop: loop.peak_gains(slope),
                    lambda loop: loop.measured_gains(slope),
                    lambda loop: loop.measured_gains(slope, rate=True),
                )
            )
            read = (by_length + slope) * step + (by_rate + 1.0) * rate_step
            late_s = bound.late_rate + slope * bound.late
            largest = max(largest, float(np.max(peaks * bound.d + late_s + read)))
        return largest if self.name == "s" else sqrt(6.0) * largest

    def beyond(self, alpha: float) -> tuple[Ultimate, float] | None:
        """Return a bound, and that of |s| or |y| in m/s, though the layer may be left; None: there is none.

        alpha: norm of Gamma - I, by rows.
        """
        lower = 1.0
        for c in SECTORS:  # the weaker the gain, the larger the error
            found = self._closed(c, alpha)
            if found is not None:
                break
            lower = c
        else:
            return None
        upper = c
        for _ in range(HALVINGS):
            c = 0.5 * (lower + upper)
            better = self._closed(c, alpha)
            lower, upper, found = (lower, c, better) if better is not None else (c, upper, found)
        return found

    def _closed(self, c: float, alpha: float) -> tuple[Ultimate, float] | None:
        """Return the bound with the layer's gain over c, and that of |s| or |y|, if its sector holds it."""
        layer = self.law.error_dynamics().layer
        sector = Sector.of(self.k, layer, c)
        judged = self.bounded(self.k / layer - sector.gain, (1.0 + alpha) * sector.rest)
        if not isinstance(judged.bound, Ultimate):
            return None
        most = self.inside(judged)
        return (judged.bound, most) if most <= sector.reach else None


def robust(subject: Subject, law: RobustSettings) -> Assessment:
    """Judge sliding mode and the Lyapunov redesign by reaching condition, layer, and the loop inside it."""
    one = Layered(subject, law)
    conditions = assumed(subject, law)
    if law.lookahead is not None:
        conditions.append(f"the {one.name} that the law predicts is no larger than the one measured")
    if law.error_dynamics().layer <= 0.0:
        claim = "without a boundary layer it switches at every tick, and chatters: give boundary_layer_m_s"
        return Assessment("not proven", claim, conditions, [], {})
    judged = one.bounded()
    if not judged.slowest.stable:
        return Assessment("unstable", unstable(subject, judged.slowest.largest), [], *describe(judged))
    if isinstance(judged.bound, str):
        return Assessment("not proven", f"with what is stated: {judged.bound}", conditions, [], {})
    if subject.nothing:
        size, alpha = one.stated
        found = _reaching(one, Inertia(alpha, alpha, 1.0 - alpha, 1.0 - alpha), np.full(6, size), judged)
    else:
        alpha = judged.inertia.alpha
        found = _reaching(one, judged.inertia, np.max([b.d for _, b in judged.bounds], axis=0), judged)
    if isinstance(found, str):
        return Assessment("not proven", found, conditions, [], {})
    reaching, lines, figures = found
    for more, numbers in (describe(judged), bound_lines(judged, judged.bound, "joint")):
        lines, figures = lines + more, {**figures, **numbers}
    if reaching.surplus <= 0.0:
        f = figures["reaching"]
        short = f"{f['gamma']:.3g} x {one.k:.3g} m/s^2 do not cover {f['disturbance_m_s2']:.3g} m/s^2 of "
        claim = f"{short}{one.source}: {one.name} need not reach its layer"
        return Assessment("not proven", claim, conditions, lines, figures)
    if isfinite(reaching.room):
        within = f"while no leg is more than {reaching.room:.3g} m/s off its rate"
        if one.name == "y":
            within = f"while the root of the legs' summed squares is no more than {reaching.room:.3g} m off"
        conditions.append(f"from outside its layer: {within}")
    error, claim = judged.bound.error, f"{one.name} reaches its layer"
    if reaching.covered:
        claim += " and stays there"
    else:
        beyond = one.beyond(alpha)
        line = "nothing is known without that: a wider layer, or more gain"
        if beyond is not None:
            bound, most = beyond[0].error, beyond[1]
            line = f"without taking the law for linear: |{one.name}| below {most:.3g} m/s, errors below "
            line += f"{1e3 * bound.max():.3g} mm of leg length"
            figures["beyond"] = {"inside_m_s": most, "ultimate_bound": bound.tolist()}
        lines.append(f"beyond layer   {line}")
        conditions.append(
            f"{one.name} may leave its layer of {reaching.layer:.3g} m/s up to {reaching.inside:.3g} m/s, by "
            "delay or by what the error of the model makes of the law's linear part: there the law is no "
            "longer linear, and the bound takes it for linear"
        )
        error = np.maximum(error, reaching.inside / one.slope)
    figures["ultimate_bound"] = error.tolist()
    claim += f", errors stay below {1e3 * error.max():.3g} mm of leg length along the reference"
    return Assessment("conditional", claim, [*conditions, SURVEYED], lines, figures)


def _reaching(
    one: Layered, inertia: Inertia, d: Array, judged: Judged
) -> tuple[Reaching, list[str], dict[str, Any]] | str:
    """Return what the law promises of its layer, with lines and figures; or why nothing is known.

    d (6,): m/s^2, the largest disturbance of each leg.
    """
    law, layer = one.law, one.law.error_dynamics().layer
    inside = one.inside(judged)
    if isinstance(law, SlidingModeSettings):
        gamma, size = inertia.dominance, float(d.max())
        found = sliding(one.slope, one.k, layer, gamma=gamma, alpha=inertia.alpha, d=size, inside=inside)
    else:
        gamma, size = inertia.definite, float(np.linalg.norm(d))
        K_P, K_D = (float(gain.max()) for gain in law.gains())
        if gamma < 0.5:
            return f"the robot does {gamma:.2g} of what is asked at worst, and below 0.5 nothing is proven"
        if float(np.min(law.gains()[1])) < K_D:
            return "the redesign is proven here for legs of equal gains"
        found = redesign(
            K_P, K_D, one.k, layer, gamma=gamma, alpha=inertia.alpha_2, d=size, inside=inside
        )  # fmt: skip
    return found, *reaching_lines(found, one.k, size, gamma, one.source, one.name)
