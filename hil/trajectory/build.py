"""From the configuration's `reference` section to a trajectory.

Rule of the room: a table of kinds; each kind is built in its own file.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from drivers.errors import ConfigurationError
from hil.config import (
    HoldReference,
    Pose,
    ReferenceSettings,
    SampledReference,
    SinusoidReference,
    WaypointReference,
)
from hil.trajectory.holding import hold_words
from hil.trajectory.path import Trajectory, require_half_turn, six_words
from hil.trajectory.sampled import sampled_trajectory
from hil.trajectory.sinusoids import SinusoidTrajectory
from hil.trajectory.waypoints import waypoint_trajectory


def _hold(settings: HoldReference, home: Pose, folder: Path | None) -> Trajectory:  # noqa: ARG001
    chi = six_words(settings.pose or home)
    require_half_turn(float(np.linalg.norm(chi[3:])), "reference.pose.rotation_vector_deg")
    return hold_words(chi, settings.duration_s)


def _waypoints(settings: WaypointReference, home: Pose, folder: Path | None) -> Trajectory:  # noqa: ARG001
    return waypoint_trajectory(settings)


def _sinusoids(settings: SinusoidReference, home: Pose, folder: Path | None) -> Trajectory:  # noqa: ARG001
    return SinusoidTrajectory(settings, home)


def _sampled(settings: SampledReference, home: Pose, folder: Path | None) -> Trajectory:  # noqa: ARG001
    if folder is None:
        raise ConfigurationError(
            f"reference.path: {settings.path} needs the configuration's folder; there is none here."
        )
    return sampled_trajectory(settings, folder)


BUILDERS: dict[type, Callable[..., Trajectory]] = {
    HoldReference: _hold,
    WaypointReference: _waypoints,
    SinusoidReference: _sinusoids,
    SampledReference: _sampled,
}
"""Settings model -> builder."""


def build_trajectory(settings: ReferenceSettings, home: Pose, folder: Path | None) -> Trajectory:
    """Return the trajectory of the `reference` section.

    home: the platform's home pose, the default of hold and sinusoids; folder: that of the configuration
    file, to which a CSV path is relative; without one a CSV is refused. Raises ConfigurationError on what
    cannot be a trajectory.
    """
    return BUILDERS[type(settings)](settings, home, folder)
