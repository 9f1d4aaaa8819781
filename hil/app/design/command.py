"""`hil design`: computes an H-infinity or mu controller from a design file, and writes a controller file."""

import importlib.resources
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from drivers.arrays import Array
from drivers.errors import ConfigurationError
from hil.app.configuration.section_file import read_section
from hil.app.design.robustness import couplings, for_the_robot, robustness
from hil.app.files import printable
from hil.config.axis_model import AxisModel
from hil.config.design import Design, DesignAxis
from hil.config.linear_controller import LinearController
from hil.design.synthesis.methods import NOTHING, Designed, design_hinf, design_mu
from hil.design.synthesis.multiplicative import Relative, relative
from hil.design.synthesis.result import linear_controller

Method = Callable[[Design, DesignAxis, Callable[[str], None], Relative | None], Designed]

METHODS: dict[str, Method] = {"hinf": design_hinf, "mu": design_mu}
"""Methods of `hil design` by name."""

PD_CROSSOVER = 2.058
"""Crossover of (2 wn s + wn^2) / s^2, in wn."""
PINNED = 1.01
"""Ratio of the optimum to its floor at rest, up to which only noise and error at rest determine it."""
SPREAD = 0.2
"""Largest deviation of a gain from the mean of six axes for which one controller is enough."""
HEAD = "# Made by `hil design {method} {source}`; law state_space runs it.\n"


def shipped_designs() -> tuple[str, ...]:
    """Names of the design files shipped with the package."""
    files = (importlib.resources.files("configs") / "designs").iterdir()
    return tuple(sorted(file.name.removesuffix(".yaml") for file in files if file.name.endswith(".yaml")))


def load_design(source: str) -> tuple[Design, Path]:
    """(design, its file) from a path or the name of a shipped design.

    Raises ConfigurationError with all problems found.
    """
    path = Path(source)
    if not path.exists():
        if source not in shipped_designs():
            names = ", ".join(shipped_designs())
            raise ConfigurationError(f"{source}: no such file; shipped designs are: {names}")
        path = Path(str(importlib.resources.files("configs") / "designs" / f"{source}.yaml"))
    return read_section(path, Design)[0], path


def axis_of(design: Design, folder: Path, model: Path | None) -> tuple[DesignAxis, Relative | None]:
    """(axis, deviation) of a design: axis from the given model file, the design's model file or its figures.

    The deviation of the measured axes from the axis is None without a measurement.

    Raises ConfigurationError: no axis, an axis of another space or rate, or six axes that differ too much.
    """
    file = model if model is not None else None if design.model is None else folder / design.model
    if file is None:
        if design.nominal is None:
            raise ConfigurationError(
                "the design has no axis, allowed: its figures in section nominal, or a file of `hil "
                "identify` in `model` or with --model"
            )
        return design.nominal, None
    found = read_section(file, AxisModel)[0]
    for key, given, wanted in (("axes", found.axes, design.axes), ("rate_Hz", found.rate_Hz, design.rate_Hz)):
        if given != wanted:
            raise ConfigurationError(f"{file}: {key}: {given}, allowed: as in the design, {wanted}")
    gains = np.array(found.nominal.gain)
    mean = float(np.exp(np.log(gains).mean()))
    if np.abs(gains / mean - 1.0).max() > SPREAD:
        listed = ", ".join(f"{gain:.3g}" for gain in gains)
        raise ConfigurationError(
            f"{file}: nominal.gain: {listed}, allowed: within {100 * SPREAD:.0f} % of their mean {mean:.3g}, "
            "as one controller serves all six axes; a better model of the robot makes them more equal"
        )
    axis = DesignAxis(gain=mean, transport_ms=found.nominal.transport_ms, lag_ms=found.nominal.lag_ms)
    return axis, relative(found, mean)


def run_design(
    method: str, source: str, model: Path | None, progress: Callable[[str], None], robot: str | None = None
) -> tuple[LinearController, Designed, Design, DesignAxis]:
    """Design a controller; return it with the synthesis result, the design and the axis.

    robot: a configuration; the loop must be stable with its coupled axes and every payload within its ranges.
    Raises ConfigurationError for files, SynthesisError for an infeasible design.
    """
    design, path = load_design(source)
    axis, measured = axis_of(design, path.parent, model)
    Gammas: list[Array] = []
    if robot is not None:
        progress("the robot along its reference")
        Gammas = couplings(robot, design.axes, design.rate_Hz)
        design, axis = for_the_robot(design, axis, Gammas, keep_gain=measured is not None)
    made = METHODS[method](design, axis, progress, measured)
    made = made._replace(figures=made.figures | robustness(design, axis, made, measured, Gammas))
    controller = linear_controller(design, method, made.judged, made.figures)
    return controller, made, design, axis


def controller_text(controller: LinearController, source: str) -> str:
    """Text of a controller file: a line for each row of a matrix, with all digits."""
    document = controller.model_dump(mode="json")
    text = yaml.dump(document, sort_keys=False, default_flow_style=None, width=2000, allow_unicode=True)
    return HEAD.format(method=controller.method, source=printable(Path(source).stem)) + text


def summary(controller: LinearController, source: str) -> dict[str, Any]:
    """Summary of a designed controller for `--json`."""
    return {
        "success": True,
        "kind": "design",
        "source": source,
        "method": controller.method,
        "order": len(controller.A),
        **controller.design,
    }


MET = "below 1 no single cause exceeds its weights, whatever the uncertainty"
LEFT_OUT = f"Hankel singular values below {NOTHING:g} of the largest"
ROWS = (
    ("gamma", "gamma", "{gamma:.4f}, {gamma_opt:.4f} at best; below 1 no single cause exceeds its weights"),
    ("gamma", "norm", "{norm:.4f}, of the exact sampled loop {norm_sampled:.4f}"),
    ("mu_upper", "mu", "up to {mu_upper:.4f} at {mu_peak_rad_s:.3g} rad/s; " + MET),
    ("mu_upper", "at every frequency", "{mu_proven:.4f}, by scales of order 1"),
    ("mu_upper", "sampled loop", "{norm_sampled_corners:.4f} at the corners of the uncertainty"),
    ("mu_upper", "without uncertainty", "{nominal_performance:.4f}"),
    (
        "mu_upper",
        "coupled axes",
        "stable where J M^-1 M_believed J^-1 has eigenvalues {covered[0]:.3g} to {covered[1]:.3g}",
    ),
    ("mu_upper", "rounds", "{shown_rounds}"),
    ("mu_upper", "states left out", "{states_left_out}" + f", of {LEFT_OUT}"),
    ("axis", "crossover", "{crossover_rad_s:.1f} rad/s, as PD of wn {wn:.1f}"),
    ("axis", "margins", "{phase_margin_deg:.1f} deg, {delay_margin_ms:.2f} ms, gain {down:.2f} to {up:.2f}"),
    ("axis", "peak of S, T", "{peak_S:.2f}, {peak_T:.2f}"),
    ("axis", "controller's poles", "up to {fastest:.0f} rad/s; half Nyquist {half_nyquist:.0f}"),
    ("axis", "closed loop's poles", "from {slowest:.1f} rad/s"),
    ("measured", "|W T|, measured", "{measured[words]}; stable below 1"),
    ("robot", "axes together", "stable, eigenvalues of Gamma {low:.3g} to {high:.3g}{robot[words]}"),
)
"""Figure that a row needs, its name, and its text."""


def report(controller: LinearController) -> list[str]:
    """Report of a design for the terminal: use of the weights, margins, poles."""
    d: dict[str, Any] = dict(controller.design)
    d["down"], d["up"] = d["gain_margin"]
    d["low"], d["high"] = d.get("robot", {}).get("gamma_eigenvalues", (0.0, 0.0))
    d["wn"] = d["crossover_rad_s"] / PD_CROSSOVER
    d["fastest"] = max(float(np.hypot(*pole)) for pole in d["controller_poles_rad_s"])
    d["slowest"] = min(-pole[0] for pole in d["closed_loop_poles_rad_s"])
    d["half_nyquist"] = np.pi * controller.rate_Hz / 2
    if "mu_upper" in d:
        gain, share = d["axis"]["gain"], d["uncertainty"]["inertia"]
        d["covered"] = gain / (1 + share), gain / (1 - share)
        d["shown_rounds"] = " ".join(f"{peak:.3f}" for peak in d["rounds"])
    for key, before in (("measured", ""), ("robot", "; |W T| ")):
        if key in d:
            near = "{norm:.3f}, nearest to 1 at {Hz:.3g} Hz"
            found = d[key]
            words = ""
            if "norm" in found:
                words = before + near.format(norm=found["norm"], Hz=found["at_rad_s"] / (2 * np.pi))
            d[key] = found | {"words": words}
    axes = f"each of six {controller.axes} axes, {controller.rate_Hz:g} Hz"
    lines = [f"{len(controller.A)} states for {axes}, from {' and '.join(controller.inputs)}"]
    lines += [f"  {name:20}{text.format(**d)}" for needs, name, text in ROWS if needs in d]
    if d.get("gamma_opt", np.inf) <= PINNED * d.get("gamma_at_rest", 0.0):
        lines.append(
            "note: the best gamma is noise.error_m times the error weight at rest, so no other weight limits "
            "it; raise error.low_m until one does, or tighten another weight"
        )
    return lines
