"""Reads the controller of law `state_space` from its file, and checks that the loop can run it."""

from pathlib import Path
from typing import Any

import numpy as np

from drivers.errors import ConfigurationError
from hil.app.configuration.section_file import read_section
from hil.app.configuration.text_file import shipped, shipped_file
from hil.app.configuration.yaml_positions import Problem
from hil.config.linear_controller import LinearController
from hil.control import ControllerSettings
from hil.control.law import Law
from hil.control.state_space import StateSpace, StateSpaceSettings, require_rate

KIND = "controllers"
"""Folder of the shipped controllers."""
ROUNDING = 1e-9
"""Tolerance above 1 for the pole of an integrator."""
TOGETHER = 1e-6
"""Distance from 1 of poles that count as integrators: rounding splits a double pole by some 1e-8."""
APART = 1e-3
"""Least singular value of the eigenvectors of separate integrators; those of a double pole are parallel to
its splitting by rounding."""


def controller_path(settings: StateSpaceSettings, folder: Path) -> Path:
    """File of a designed controller: relative to `folder`, or of a shipped controller by its name."""
    file, name = folder / settings.controller_file, settings.controller_file
    return shipped_file(name, KIND) if not file.exists() and name in shipped(KIND) else file


def read_controller(path: Path) -> LinearController:
    """Read a designed controller from its file.

    Raises ConfigurationError with all problems found; also for a controller that is unstable by itself,
    unless the file's `design` has `unstable_controller: true`.
    """
    controller, document = read_section(path, LinearController)
    # poles of the sampled controller; a controller without states has none
    poles, vectors = np.linalg.eig(np.array(controller.A, float) if controller.A else np.zeros((1, 1)))
    radius = float(np.abs(poles).max())
    own = vectors[:, np.abs(poles - 1.0) < TOGETHER]
    twice = np.linalg.matrix_rank(own, tol=APART) < own.shape[1]
    unstable = radius > 1.0 + ROUNDING and controller.design.get("unstable_controller") is not True
    if twice or unstable:
        message = (
            "the sampled controller integrates twice in series, so that its state may grow without bound, "
            f"allowed: poles within {TOGETHER:g} of 1 only in parallel; design with another weight"
            if twice
            else "the sampled controller is unstable by itself, allowed: poles up to 1 in magnitude, given: "
            f"{radius:.6g}; design with softer weights, or set design.unstable_controller: true"
        )
        raise ConfigurationError(Problem(document.value_position(("A",)), ("A",), message).line(str(path)))
    return controller


def controller_of(settings: ControllerSettings, folder: Path) -> LinearController | None:
    """Designed controller of a law's settings; None for a law without one.

    Raises ConfigurationError as `read_controller`.
    """
    if not isinstance(settings, StateSpaceSettings):
        return None
    path = controller_path(settings, folder)
    if not path.exists():
        raise ConfigurationError(
            "no such file, allowed: a file that `hil design` wrote, or a shipped controller "
            f"({', '.join(shipped(KIND))}), given: {settings.controller_file} (looked for {path})"
        )
    return read_controller(path)


def unusable(settings: ControllerSettings, rate_Hz: float, folder: Path) -> str | None:
    """Reason why a loop at `rate_Hz` cannot run a law's designed controller; None if it can."""
    try:
        controller = controller_of(settings, folder)
        if controller is not None:
            require_rate(controller, rate_Hz)
    except ConfigurationError as error:
        return str(error).removeprefix("controller.controller_file: ")
    return None


def law_figures(settings: ControllerSettings, law: Law) -> dict[str, Any]:
    """Name and order of a control law, for the summary of a run."""
    order = law.order if isinstance(law, StateSpace) else None
    return {"law": settings.law, "controller_order": order}
