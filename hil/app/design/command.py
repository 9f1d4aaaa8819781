"""`hil design`: a design file in, a controller file out."""

import importlib.resources
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from drivers.arrays import Array
from drivers.errors import ConfigurationError
from hil.app.configuration.section_file import read_section
from hil.app.design.robot import couplings
from hil.app.design.robustness import for_the_robot, robustness
from hil.app.files import printable
from hil.config.axis_model import AxisModel
from hil.config.design import Design, DesignAxis
from hil.config.linear_controller import LinearController
from hil.design.synthesis.hinf_design import Designed, design_hinf
from hil.design.synthesis.mu_design import NOTHING, design_mu
from hil.design.synthesis.multiplicative import Relative, relative
from hil.design.synthesis.result import linear_controller

Method = Callable[[Design, DesignAxis, Callable[[str], None], Relative | None], Designed]

METHODS: dict[str, Method] = {"hinf": design_hinf, "mu": design_mu}
"""What `hil design` offers, by name."""

PD_CROSSOVER = 2.058
"""Times wn: where (2 wn s + wn^2) / s^2 crosses over."""
PINNED = 1.01
"""An optimum below this times its floor at rest is set by noise and error allowed there alone."""
SPREAD = 0.2
"""Gains of the six axes that differ from their mean by more are not alike: one controller will not do."""
HEAD = "# Made by `hil design {method} {source}`; law state_space runs it.\n"


def shipped_designs() -> tuple[str, ...]:
    """Return the names of the designs that come with the product."""
    files = (importlib.resources.files("configs") / "designs").iterdir()
    return tuple(sorted(file.name.removesuffix(".yaml") for file in files if file.name.endswith(".yaml")))


def load_design(source: str) -> tuple[Design, Path]:
    """Return a design and its file: a path, or the name of a shipped one.

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
    """Return the axis of a design: of the file given, of the one that it names, or its own figures.

    And by how much the measured axes differ from it, where they were measured.

    Raises ConfigurationError: no axis, one of another space or rate, or six that are not alike.
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
            raise ConfigurationError(f"{file}: {key}: {given}, allowed: that of the design, {wanted}")
    gains = np.array(found.nominal.gain)
    mean = float(np.exp(np.log(gains).mean()))
    if np.abs(gains / mean - 1.0).max() > SPREAD:
        listed = ", ".join(f"{gain:.3g}" for gain in gains)
        raise ConfigurationError(
            f"{file}: nominal.gain: {listed}, allowed: within {100 * SPREAD:.0f} % of their mean {mean:.3g}, "
            "for one controller serves all six axes; a better model of the robot makes them alike"
        )
    axis = DesignAxis(gain=mean, transport_ms=found.nominal.transport_ms, lag_ms=found.nominal.lag_ms)
    return axis, relative(found, mean)


def run_design(
    method: str, source: str, model: Path | None, progress: Callable[[str], None], robot: str | None = None
) -> tuple[LinearController, Designed, Design, DesignAxis]:
    """Design a controller.

    robot: a configuration whose axes it has to stand coupled, with every payload within its ranges.
    Raises ConfigurationError for files, SynthesisError for what cannot be designed.
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
    """Return the controller's file: rows of a matrix in a line each, all digits."""
    document = controller.model_dump(mode="json")
    text = yaml.dump(document, sort_keys=False, default_flow_style=None, width=2000, allow_unicode=True)
    return HEAD.format(method=controller.method, source=printable(Path(source).stem)) + text


def summary(controller: LinearController, source: str) -> dict[str, Any]:
    """Return what the JSON file holds."""
    return {
        "success": True,
        "kind": "design",
        "source": source,
        "method": controller.method,
        "order": len(controller.A),
        **controller.design,
    }


def report(controller: LinearController) -> list[str]:
    """Return what the user reads: how much of the weights is used, margins, poles."""
    d = controller.design
    down, up = d["gain_margin"]
    fastest = max(float(np.hypot(*pole)) for pole in d["controller_poles_rad_s"])
    slowest = min(-pole[0] for pole in d["closed_loop_poles_rad_s"])
    rows = [
        *_figures(d),
        (
            "crossover",
            f"{d['crossover_rad_s']:.1f} rad/s, as PD of wn {d['crossover_rad_s'] / PD_CROSSOVER:.1f}",
        ),
        (
            "margins",
            f"{d['phase_margin_deg']:.1f} deg, {d['delay_margin_ms']:.2f} ms, gain {down:.2f} to {up:.2f}",
        ),
        ("peak of S, T", f"{d['peak_S']:.2f}, {d['peak_T']:.2f}"),
        (
            "controller's poles",
            f"up to {fastest:.0f} rad/s; half Nyquist {np.pi * controller.rate_Hz / 2:.0f}",
        ),
        ("closed loop's poles", f"from {slowest:.1f} rad/s"),
    ]
    rows += _robust_rows(d)
    headline = (
        f"{len(controller.A)} states for each of six {controller.axes} axes, {controller.rate_Hz:g} Hz, from "
        f"{' and '.join(controller.inputs)}"
    )
    return [headline, *(f"  {name:20}{value}" for name, value in rows), *_remarks(d)]


def _robust_rows(design: dict[str, Any]) -> list[tuple[str, str]]:
    """Return how near the loop comes to what measured axes, and the robot's coupling, make unstable."""
    rows = []

    def nearest(found: dict[str, float]) -> str:
        return f"{found['norm']:.3f}, nearest to 1 at {found['at_rad_s'] / (2 * np.pi):.3g} Hz"

    if "measured" in design:
        rows.append(("|W T|, measured", f"{nearest(design['measured'])}; stable below 1"))
    if "robot" in design:
        low, high = design["robot"]["gamma_eigenvalues"]
        words = f"stable, eigenvalues of Gamma {low:.3g} to {high:.3g}"
        if "norm" in design["robot"]:
            words += f"; |W T| {nearest(design['robot'])}"
        rows.append(("axes together", words))
    return rows


def _remarks(design: dict[str, Any]) -> list[str]:
    """Say where being near the optimum means less than it seems to."""
    if design.get("gamma_opt", np.inf) > PINNED * design.get("gamma_at_rest", 0.0):
        return []
    remark = (
        "note: the best gamma is noise.error_m times the error weight at rest, so no other weight limits it; "
        "raise error.low_m until one does, or ask for more elsewhere"
    )
    return [remark]


def _figures(design: dict[str, Any]) -> list[tuple[str, str]]:
    """Return the rows that only some methods have."""
    if "mu_upper" in design:
        worst = f"{design['mu_lower']:.4f} to {design['mu_upper']:.4f} at {design['mu_peak_rad_s']:.3g} rad/s"
        g, r = design["axis"]["gain"], design["uncertainty"]["inertia"]
        return [
            ("mu", f"{worst}; below 1 no single cause exceeds its weights, whatever the uncertainty"),
            ("at every frequency", f"{design['mu_proven']:.4f}, by scales of order 1"),
            ("sampled loop", f"{design['norm_sampled_corners']:.4f} at the corners of the uncertainty"),
            ("without uncertainty", f"{design['nominal_performance']:.4f}"),
            (
                "coupled axes",
                f"stable where J M^-1 M_believed J^-1 has eigenvalues {g / (1 + r):.3g} to {g / (1 - r):.3g}",
            ),
            ("rounds", " ".join(f"{peak:.3f}" for peak in design["rounds"])),
            (
                "states left out",
                f"{design['states_left_out']}, of Hankel singular values below {NOTHING:g} of the largest",
            ),
        ]
    if "gamma" not in design:
        return []
    best = f"{design['gamma_opt']:.4f} at best; below 1 no single cause exceeds its weights"
    exact = f"of the exact sampled loop {design['norm_sampled']:.4f}"
    return [("gamma", f"{design['gamma']:.4f}, {best}"), ("norm", f"{design['norm']:.4f}, {exact}")]
