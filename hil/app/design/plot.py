"""Picture of a designed controller: closed loop and weights, open loop, response to a disturbance step."""

from pathlib import Path
from typing import Any

import numpy as np

from drivers.arrays import Array, ComplexArray
from drivers.files import whole_file
from hil.app.files import printable
from hil.config.design import Design, DesignAxis
from hil.design.stability.sampled_loop import grid
from hil.design.synthesis.axis import around, loop_gain, sampled_axis, sampled_problem
from hil.design.synthesis.methods import Designed
from hil.design.synthesis.weights import control_weight
from hil.mathematics.linear_system import LinearSystem

STEP_S = 0.3


def draw(design: Design, axis: DesignAxis, made: Designed, path: Path, title: str) -> Path:
    """Draw a designed loop, exact and sampled, into a PNG file. Raises OSError if that fails."""
    from matplotlib.figure import Figure  # noqa: PLC0415 - half a second

    figure = Figure(figsize=(13, 8.5), layout="constrained")
    axes = figure.subplots(2, 2)
    K, inputs = made.judged.sampled, design.inputs
    legs = sampled_axis(axis, design.rate_Hz, inputs)
    omega = grid(1.0 / design.rate_Hz)
    omega = omega[(omega > 0.1) & (omega < omega[-1])]
    L = loop_gain(K, legs).response(omega)[:, 0, 0]
    _closed(axes[0, 0], design, omega, L)
    _weighted(axes[0, 1], design, omega, sampled_problem(design, axis).closed_with(K), made.figures)
    _open(axes[1, 0], omega, L, made.figures)
    _step(axes[1, 1], design, around(legs).closed_with(K))
    for each in axes.flat:
        each.grid(alpha=0.3, which="both")
    for each in axes[0]:
        each.legend(fontsize=8)
    figure.suptitle(printable(title), parse_math=False)
    with whole_file(path) as temporary:
        figure.savefig(temporary, dpi=100)
    return path


def _closed(axes: Any, design: Design, omega: Array, L: ComplexArray) -> None:
    weights = design.weights
    limit = 1.0 / np.abs(control_weight(weights.control, design.rate_Hz).response(omega)[:, 0, 0])
    limit /= design.weights.disturbance.amplitude_m_s2
    axes.loglog(omega, np.abs(1.0 / (1.0 + L)), label="S")
    axes.loglog(omega, np.abs(L / (1.0 + L)), label="T, control over disturbance")
    axes.loglog(omega, limit, "k--", linewidth=0.8, label="control allowed over disturbance")
    axes.set(xlabel="rad/s", title="sensitivity and its complement", ylim=(1e-3, 10))


def _weighted(axes: Any, design: Design, omega: Array, closed: LinearSystem, figures: dict[str, Any]) -> None:
    """Draw each path times its weights: all together stay below gamma; below 1 the design is met."""
    size = np.abs(closed.response(omega))
    causes = ["disturbance", *(f"noise of {name}" for name in design.inputs)]
    for i, effect in enumerate(("error", "control")):
        for j, cause in enumerate(causes):
            axes.loglog(omega, size[:, i, j], ":" if j else "-", label=f"{cause} to {effect}")
    axes.axhline(1.0, color="black", linewidth=0.8)
    if "gamma" in figures:
        axes.axhline(figures["gamma"], color="black", linestyle="--", linewidth=0.8, label="gamma")
    if "mu" in figures:
        mu = figures["mu"]
        axes.loglog(mu["omega_rad_s"], mu["upper"], "k", label="mu, upper bound")
    axes.set(xlabel="rad/s", title="share of the weights that each path takes", ylim=(1e-3, 2))


def _open(axes: Any, omega: Array, L: ComplexArray, figures: dict[str, Any]) -> None:
    axes.loglog(omega, np.abs(L), label="|L|")
    axes.axhline(1.0, color="black", linewidth=0.8)
    axes.axvline(figures["crossover_rad_s"], color="grey", linestyle="--", linewidth=0.8)
    axes.set(xlabel="rad/s", ylabel="|L|", ylim=(1e-2, 1e4))
    phase = axes.twinx()
    angle = np.rad2deg(np.unwrap(np.angle(L)))
    phase.semilogx(omega, angle - 360.0 * np.ceil(angle[0] / 360.0), color="tab:orange")
    phase.set(ylabel="deg")
    phase.axhline(-180.0, color="tab:orange", linewidth=0.5, linestyle=":")
    axes.set_title(
        f"open loop: {figures['crossover_rad_s']:.0f} rad/s, {figures['phase_margin_deg']:.0f} deg, "
        f"{figures['delay_margin_ms']:.1f} ms"
    )


def _step(axes: Any, design: Design, closed: LinearSystem) -> None:
    """Draw error and control after a disturbance step of full amplitude."""
    d, h = design.weights.disturbance.amplitude_m_s2, 1.0 / design.rate_Hz
    x, answers = np.zeros(closed.order), []
    for _ in range(int(STEP_S / h)):
        answers.append(closed.C @ x + closed.D[:, 0] * d)
        x = closed.A @ x + closed.B[:, 0] * d
    e, u = np.array(answers).T
    t = h * np.arange(len(e))
    axes.plot(t, 1e3 * e)
    axes.set(xlabel="s", ylabel="error [mm or mrad]", title=f"step of {d:g} m/s$^2$ or rad/s$^2$")
    other = axes.twinx()
    other.plot(t, u, color="tab:orange", linewidth=0.8)
    other.set(ylabel="control")
