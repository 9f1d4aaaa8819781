"""What a robot with a payload known by ranges makes of a design: the Gamma that its axes are coupled by."""

from math import isclose

import numpy as np

from drivers.arrays import Array
from drivers.errors import ConfigurationError
from hil.app.configuration.configuration import Configuration, load
from hil.app.stability.subject import Stated, Subject
from hil.config.axis_model import AxisSpace
from hil.config.model import ModelSettings
from plant_fmu.config import BenchPlant

POSES = 25
"""Of the reference, at each corner of the payload's ranges."""


def couplings(configuration: str, axes: AxisSpace, rate_Hz: float) -> list[Array]:
    """Return Gamma (6, 6) along a configuration's reference, at each corner of its payload's ranges.

    Raises ConfigurationError: no robot, or another loop than the design's.
    """
    c = load(configuration)
    _refuse_another_loop(c, axes, rate_Hz)
    subject = Subject(c, Stated())
    path = subject.path[:: max(1, len(subject.path) // POSES)]
    model = c.controller.believed or ModelSettings()
    return [Gamma for robot in subject.linearised(model, axes) for Gamma in robot.at(path).Gamma]


def _refuse_another_loop(c: Configuration, axes: AxisSpace, rate_Hz: float) -> None:
    if c.plant is not None and isinstance(c.plant.model, BenchPlant):
        raise ConfigurationError(
            f"{c.source}: plant.model: six uncoupled legs, allowed with --robot: a configuration of the robot"
        )
    if c.loop.rate_Hz != rate_Hz:
        raise ConfigurationError(
            f"{c.source}: loop.rate_Hz: {c.loop.rate_Hz:g}, allowed: that of the design, {rate_Hz:g}"
        )
    if c.controller.axes not in (None, axes):
        raise ConfigurationError(
            f"{c.source}: controller.law {c.controller.law}: axes {c.controller.axes}, allowed: those of the "
            f"design, {axes}"
        )


def eigenvalues(Gammas: list[Array]) -> tuple[float, float]:
    """Return the least and the largest eigenvalue: real, as each Gamma is similar to M^-1 M_believed."""
    values = np.linalg.eigvals(np.array(Gammas)).real
    return float(values.min()), float(values.max())


def share_of_inertia(gain: float, least: float, largest: float) -> float:
    """Return the r for which gain / (1 + r) to gain / (1 - r) holds what lies from least to largest.

    1 or more: no r below 1 does.
    """
    return max(gain / least - 1.0, 1.0 - gain / largest, 0.0)


def middle(least: float, largest: float) -> float:
    """Return the gain for which that r is least."""
    return least if isclose(least, largest) else 2.0 / (1.0 / least + 1.0 / largest)
