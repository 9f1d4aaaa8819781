"""What `hil check` says of the controller: model, margins, and what is proven."""

from __future__ import annotations

import numpy as np

from hil.app.check.findings import Report
from hil.app.configuration.configuration import Configuration
from hil.app.configuration.controller_file import controller_of
from hil.config import (
    ErrorDynamics,
    ModelSettings,
    RobustInverseDynamicsSettings,
    SlidingModeSettings,
    StateSpaceSettings,
)
from hil.control.margin import cross_over, phase_margin_deg


def report_controller(report: Report, c: Configuration) -> None:
    """Add law, model, margins and verdict to a report."""
    law = c.controller
    report.sections["controller"] = lines = [f"law {law.law}"]
    if isinstance(law, LINEARISING | StateSpaceSettings):
        model = getattr(law, "model", None)
        variant = model.variant if isinstance(model, ModelSettings) else "no_H"
        lines.append(f"model {variant}")
        if variant in MODEL_WARNINGS:
            report.warnings.append(f"controller.model.variant {variant}: {MODEL_WARNINGS[variant]}")
    if isinstance(law, LINEARISING):
        lines += _margin(report, c, *law.linear_gains)
    if isinstance(law, StateSpaceSettings):
        lines += _designed(report, c, law)
    if isinstance(law, SlidingModeSettings):
        phi = law.boundary_layer
        lines.append(
            f"switching gain {law.switching_gain:.3g} m/s^2, boundary layer {phi:.3g} m/s: "
            f"|e| <= {1e3 * phi / law.lambda_rad_s:.3g} mm"
        )
    if isinstance(law, RobustInverseDynamicsSettings):
        lines.append(f"bound rho {law.bound:.3g} m/s^2, boundary layer {law.boundary_layer_m_s:.3g} m/s")
    _stability(report, c)


def _stability(report: Report, c: Configuration) -> None:
    """Say in one line what is proven of the law."""
    from hil.app.stability.command import judge  # noqa: PLC0415 - scipy, which `hil run` and `hil sim` do without

    verdict = judge(c, quick=True)
    report.sections["controller"].append(f"stability {verdict.line}")
    report.figures["stability"] = {
        "verdict": verdict.status,
        "claim": verdict.claim,
        "conditions": verdict.conditions,
    }
    if verdict.status == "unstable":
        report.warnings.append(f"controller: {verdict.claim}")


def _margin(report: Report, c: Configuration, K_P: float, K_D: float) -> list[str]:
    """Return what the loop's delay costs a law with these gains, and warn where too little is left."""
    transport, lag = _path_s(c)
    delay = transport + 0.5 / c.loop.rate_Hz + lag  # the zero-order hold is half a period
    if np.isinf(K_D):
        report.warnings.append(
            "controller.boundary_layer_m_s 0 switches between two forces at every tick: with "
            f"{1e3 * delay:.1f} ms of delay it chatters; make it thicker"
        )
        return ["no boundary layer: the law switches"]
    w_c, whole, left = cross_over(K_P, K_D), phase_margin_deg(K_P, K_D), phase_margin_deg(K_P, K_D, delay)
    report.figures["controller"] = {
        "cross_over_rad_s": w_c,
        "delay_ms": 1e3 * delay,
        "phase_loss_deg": whole - left,
        "phase_margin_deg": left,
    }
    if left < LEAST_MARGIN_DEG:
        keys, remedy = TUNING.get(c.controller.law, ("wn_rad_s", "lower it"))
        report.warnings.append(
            f"controller.{keys}: about {left:.0f} degrees of phase margin at loop.rate_Hz "
            f"{c.loop.rate_Hz:g}, advised: at least {LEAST_MARGIN_DEG:g}; {remedy} or raise the rate"
        )
    line = f"crosses over at {w_c:.0f} rad/s; {1e3 * delay:.1f} ms of delay cost about {whole - left:.0f} of "
    return [line + f"{whole:.0f} degrees of phase margin"]


def _path_s(c: Configuration) -> tuple[float, float]:
    """Return the time from SYNC to force, at most one period, and the lag of the drives' force loop."""
    lag = 0.0
    if c.plant is not None and c.plant.model.type == "stewart" and c.plant.model.force_bandwidth_Hz > 0:
        lag = 1 / (2 * np.pi * c.plant.model.force_bandwidth_Hz)
    return 0.0 if c.bus.layout == "ideal" else 1.0 / c.loop.rate_Hz, lag


def _designed(report: Report, c: Configuration, law: StateSpaceSettings) -> list[str]:
    """Return what the designed controller is and what its loop leaves, and warn where that is too little."""
    from hil.app.design.loop import judge  # noqa: PLC0415 - scipy, for the few who design

    controller = controller_of(law, c.folder)
    assert controller is not None
    lines, figures, warnings = judge(law.controller_file, controller, *_path_s(c), LEAST_MARGIN_DEG)
    report.figures["controller"] = figures
    report.warnings += warnings
    return lines


LINEARISING = ErrorDynamics | SlidingModeSettings | RobustInverseDynamicsSettings
"""Laws that leave e'' + K_D e' + K_P e = d of an error, at least while it is small."""
LEAST_MARGIN_DEG = 30.0
TUNING = {
    "sliding_mode": ("lambda_rad_s and boundary_layer_m_s", "make lambda smaller, the layer thicker,"),
    "robust_inverse_dynamics": ("wn_rad_s and boundary_layer_m_s", "make wn smaller, the layer thicker,"),
}
"""By law: what sets its gains beside wn alone, and how to lower them."""
MODEL_WARNINGS = {
    "constant": (
        "M, G and J frozen at one pose: good for small motion only. On the book's path (0.6 m, 19 deg) it "
        "ends 395 mm off, through a singularity at 1.011 s into another assembly; constant_MG ends at 2.2 mm"
    ),
    "constant_MG": "M and G frozen at one pose: 2.2 mm on the book's path, full 0.03 mm",
    "printed": (
        "without H and without J_dot twist: the latter is up to 15.7 % of the force on the book's path "
        "(2.6 mm of leg error there)"
    ),
}
"""Figures: book platform, book path, wn 20 rad/s, 1 kHz."""
