"""Lines and figures of assessed laws that linearise the robot."""

from math import isfinite
from typing import Any

import numpy as np

from drivers.arrays import Array
from hil.app.stability.subject import Subject
from hil.config.axis_model import AxisSpace
from hil.stability.error_dynamics import decay_rate
from hil.stability.reaching import Reaching
from hil.stability.sampled import Sampled
from hil.stability.ultimate import Ultimate


def beside(subject: Subject) -> str:
    """Return what the bound of a moving reference does not hold: it is that of a law without sampling."""
    return "" if subject.rest else ", beside what its sampling costs"


def describe(loop: Sampled) -> tuple[list[str], dict[str, Any]]:
    """Return the sampled loop as lines and figures."""
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
        f"{subject.delay}: lower the gains or the delay"
    )


def decay(bound: Ultimate) -> float:
    """Return the slowest decay of the six axes with the gains that the robot has, 1/s."""
    proved = bound.certificate
    return min(decay_rate(float(p), float(d)) for p, d in zip(proved.K_P, proved.K_D, strict=True))


def _late(bound: Ultimate, loop: Sampled) -> float:
    """Return by how much delay and sampling raise the bound: where the late loop's peak gain is above it."""
    return max(1.0, loop.peak_gain / float(bound.certificate.error_gain().min()))


def worst(bound: Ultimate, loop: Sampled, axes: AxisSpace) -> str:
    """Return the ultimate bound in words."""
    error = _late(bound, loop) * bound.error
    if axes == "joint":
        return f"{1e3 * error.max():.3g} mm of leg length"
    return f"{1e3 * error[:3].max():.3g} mm and {np.degrees(error[3:].max()):.3g} deg"


def bound_lines(bound: Ultimate, loop: Sampled, axes: AxisSpace) -> tuple[list[str], dict[str, Any]]:
    """Return certificate and bound as lines and figures."""
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


def reaching_lines(
    found: Reaching, k: float, d: float, gamma: float, source: str, name: str
) -> tuple[list[str], dict[str, Any]]:
    """Return what a boundary layer promises as lines and figures."""
    legs, linear = ("a leg", "") if name == "s" else ("all legs", " with its linear part")
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
            f"{found.surplus:.3g} m/s^2 to spare{linear}"
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
