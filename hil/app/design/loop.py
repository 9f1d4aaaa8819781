"""Stability margins of a designed controller with a configuration's delay, for `hil check`."""

from typing import Any, NamedTuple

from hil.app.loop_delay import LoopDelay
from hil.config.linear_controller import LinearController
from hil.design.stability.observed_loop import Observer, observed
from hil.design.stability.sampled_loop import Axis, analyse, sampled_controller


class LoopFinding(NamedTuple):
    """Lines, figures and warnings of `hil check` about a designed controller's loop."""

    lines: list[str]
    figures: dict[str, Any]
    warnings: list[str]


def judge(
    name: str,
    controller: LinearController,
    delay: LoopDelay,
    least_deg: float,
    observer: Observer | None = None,
) -> LoopFinding:
    """Stability margins of controller `name`, with a warning below `least_deg` degrees of phase margin.

    observer: observer of the wrench, if the controller compensates its estimate.
    """
    sampled = sampled_controller(controller)
    loop = analyse(Axis(*delay), sampled if observer is None else observed(sampled, observer))
    transport_ms, lag_ms = 1e3 * delay.transport_s, 1e3 * delay.lag_s
    radius, left, order = loop.largest, loop.margins, len(controller.A)
    figures = {
        "order": order, "method": controller.method, "axes": controller.axes, "rate_Hz": controller.rate_Hz,
        "transport_ms": transport_ms, "lag_ms": lag_ms, "pole_radius": radius,
    }  # fmt: skip
    what = f"controller {name}: {controller.method}, order {order} on each {controller.axes} axis"
    delays, trouble = f"{transport_ms:.1f} ms of transport and {lag_ms:.1f} ms of lag", None
    if observer is not None:
        delays += f" and the observer of {observer.bandwidth_Hz:g} Hz"
    if left is None:
        line = f"unstable with {delays}"
        trouble = f"{line}: a pole of the sampled loop at {radius:.4f}, allowed: below 1"
    else:
        figures |= {
            "cross_over_rad_s": left.crossover_rad_s,
            "phase_margin_deg": left.phase_deg,
            "sensitivity_peak": left.peak_S,
        }
        line = (
            f"crosses over at {left.crossover_rad_s:.0f} rad/s; {delays} leave {left.phase_deg:.0f} degrees "
            f"of phase margin, sensitivity at most {left.peak_S:.2f}"
        )
        if left.phase_deg < least_deg:
            trouble = (
                f"about {left.phase_deg:.0f} degrees of phase margin with {delays}, advised: at least "
                f"{least_deg:g}"
            )
    warnings = [] if trouble is None else [f"controller.controller_file: {trouble}; design for this delay"]
    return LoopFinding([what, line], figures, warnings)
