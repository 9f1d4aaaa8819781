"""The controller of law `state_space`: where its file is, and whether the loop can run what it holds."""

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
"""Folder of the shipped ones."""
ROUNDING = 1e-9
"""An integrator's pole is at 1, give or take this much."""


def controller_path(settings: StateSpaceSettings, folder: Path) -> Path:
    """Return the controller's file: relative to `folder`, or a shipped one by its name."""
    file, name = folder / settings.controller_file, settings.controller_file
    return shipped_file(name, KIND) if not file.exists() and name in shipped(KIND) else file


def read_controller(path: Path) -> LinearController:
    """Read a controller from its file.

    Raises ConfigurationError with all problems found; also for a controller that is unstable by itself,
    unless the file's `design` says so with `unstable_controller: true`.
    """
    controller, document = read_section(path, LinearController)
    # the largest magnitude of the sampled controller's poles; without a state it has none
    poles = np.linalg.eigvals(np.array(controller.A, float)) if controller.A else np.zeros(1)
    radius = float(np.abs(poles).max())
    if radius > 1.0 + ROUNDING and controller.design.get("unstable_controller") is not True:
        message = (
            f"the sampled controller is unstable by itself, allowed: poles up to 1 in magnitude, given: "
            f"{radius:.6g}; design with softer weights, or state design.unstable_controller: true"
        )
        raise ConfigurationError(Problem(document.value_position(("A",)), ("A",), message).line(str(path)))
    return controller


def controller_of(settings: ControllerSettings, folder: Path) -> LinearController | None:
    """Return the controller that a law's settings name; None for a law without one.

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
    """Say why a loop at `rate_Hz` cannot run the controller that a law's settings name; None where it can."""
    try:
        controller = controller_of(settings, folder)
        if controller is not None:
            require_rate(controller, rate_Hz)
    except ConfigurationError as error:
        return str(error).removeprefix("controller.controller_file: ")
    return None


def law_figures(settings: ControllerSettings, law: Law) -> dict[str, Any]:
    """Return what the summary of a run says of its law."""
    order = law.order if isinstance(law, StateSpace) else None
    return {"law": settings.law, "controller_order": order}
