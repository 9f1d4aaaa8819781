"""What `hil check` says of the controller: model, margins, and what is proven."""

from collections.abc import Callable

import numpy as np

from hil.app.check.findings import Report
from hil.app.configuration.configuration import Configuration
from hil.app.configuration.controller_file import controller_of
from hil.app.loop_delay import loop_delay
from hil.control.law import ErrorDynamics
from hil.control.margin import cross_over, phase_margin_deg
from hil.control.state_space import StateSpaceSettings


def report_controller(
    report: Report, c: Configuration, tell: Callable[[float, float], None] = lambda *_: None
) -> None:
    """Add law, model, margins and stability to the report; tell as for `hil.app.stability.command.judge`."""
    law = c.controller
    report.sections["controller"] = lines = [f"law {law.law}"]
    if law.axes is not None and law.believed is not None:
        variant = law.believed.variant
        lines.append(f"model {variant}")
        if variant in MODEL_WARNINGS:
            report.warnings.append(f"controller.model.variant {variant}: {MODEL_WARNINGS[variant]}")
    dynamics = law.error_dynamics()
    if isinstance(dynamics, ErrorDynamics):
        lines += _margin(report, c, float(dynamics.K_P.max()), float(dynamics.K_D.max()))
    if isinstance(law, StateSpaceSettings):
        lines += _designed(report, c, law)
    lines += law.described()
    _stability(report, c, tell)


def _stability(report: Report, c: Configuration, tell: Callable[[float, float], None]) -> None:
    """Say in one line what is proven of the law."""
    from hil.app.stability.command import judge  # noqa: PLC0415 - scipy, which `hil run` and `hil sim` do without

    found = judge(c, quick=True, tell=tell)
    report.sections["controller"].append(f"stability {found.line}")
    report.figures["stability"] = {
        "status": found.status,
        "claim": found.claim,
        "conditions": found.conditions,
    }
    if found.figures.get("coupled_axes_covered") is False:
        report.warnings.append(
            "controller.controller_file: it was designed for another inertia than the platform and the ranges"
            " of its payload have: `hil stability` shows both; design with `--robot`, or state smaller ranges"
        )
    if found.status == "unstable":
        report.warnings.append(f"controller: {found.claim}")


def _margin(report: Report, c: Configuration, K_P: float, K_D: float) -> list[str]:
    """Return what the loop's delay costs a law with these gains, and warn where too little is left."""
    delay = loop_delay(c).total_s
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
        keys, remedy = c.controller.tuning
        report.warnings.append(
            f"controller.{keys}: about {left:.0f} degrees of phase margin at loop.rate_Hz "
            f"{c.loop.rate_Hz:g}, advised: at least {LEAST_MARGIN_DEG:g}; {remedy} or raise the rate"
        )
    line = f"crosses over at {w_c:.0f} rad/s; {1e3 * delay:.1f} ms of delay cost about {whole - left:.0f} of "
    return [line + f"{whole:.0f} degrees of phase margin"]


def _designed(report: Report, c: Configuration, law: StateSpaceSettings) -> list[str]:
    """Return what the designed controller is and what its loop leaves, and warn where that is too little."""
    from hil.app.design.loop import judge  # noqa: PLC0415 - scipy, for the few who design

    controller = controller_of(law, c.folder)
    assert controller is not None
    lines, figures, warnings = judge(law.controller_file, controller, loop_delay(c), LEAST_MARGIN_DEG)
    report.figures["controller"] = figures
    report.warnings += warnings
    return lines


LEAST_MARGIN_DEG = 30.0
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
