"""Build a trajectory from the configuration's `reference` section."""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from drivers.errors import ConfigurationError
from hil.config.reference import (
    HoldReference,
    LiveReference,
    MultisineReference,
    ReferenceSettings,
    SampledReference,
    SinusoidReference,
    TimeOptimalReference,
    WaypointReference,
)
from hil.config.values import Pose
from hil.mathematics.rotations import rotation_from_vector
from hil.trajectory.live import LiveTrajectory
from hil.trajectory.multisine import multisine_trajectory
from hil.trajectory.path import HoldTrajectory, Trajectory, axis_limits, checked_coordinates
from hil.trajectory.sampled import sampled_trajectory
from hil.trajectory.sinusoids import SinusoidTrajectory
from hil.trajectory.time_optimal import plan, planned_trajectory
from hil.trajectory.waypoints import waypoint_trajectory

UNTIMED_S = 1e-3
"""Tick period assumed for a live reference that is built only for checks, without a loop, s."""


class Context(NamedTuple):
    """What a trajectory is built from in addition to its own settings."""

    home: Pose
    """Home pose of the platform, the default pose of references hold, sinusoids, multisine and live."""
    folder: Path | None
    """Folder of the configuration file; CSV paths are relative to it. None: a CSV path is an error."""
    period_s: float
    """Period of the control loop, s."""
    plan: bytes | None
    """Plan of a time-optimal reference from a log; None: plan again."""


def _hold(settings: HoldReference, context: Context) -> Trajectory:
    chi = checked_coordinates(settings.pose or context.home, "reference.pose")
    return HoldTrajectory(chi[:3], rotation_from_vector(chi[3:]), settings.duration_s)


def _sampled(settings: SampledReference, context: Context) -> Trajectory:
    if context.folder is None:
        raise ConfigurationError(
            f"reference.path: {settings.path} is relative to the configuration's folder, which is unknown."
        )
    return sampled_trajectory(settings, context.folder)


def _live(settings: LiveReference, context: Context) -> Trajectory:
    chi = checked_coordinates(settings.start or context.home, "reference.start")
    return LiveTrajectory(chi, axis_limits(settings.limits), context.period_s)


BUILDERS: dict[type, Callable[..., Trajectory]] = {
    HoldReference: _hold,
    WaypointReference: lambda s, _: waypoint_trajectory(s),
    TimeOptimalReference: lambda s, context: planned_trajectory(context.plan or plan(s), s.periods),
    SinusoidReference: lambda s, context: SinusoidTrajectory(s, context.home),
    MultisineReference: lambda s, context: multisine_trajectory(s, context.home),
    SampledReference: _sampled,
    LiveReference: _live,
}
"""Settings class of a reference -> function that builds its trajectory."""


def build_trajectory(
    settings: ReferenceSettings,
    home: Pose,
    folder: Path | None,
    period_s: float = UNTIMED_S,
    recorded: bytes | None = None,
) -> Trajectory:
    """Build the trajectory of the `reference` section.

    home: the platform's home pose; folder: folder of the configuration file; period_s: period of the loop;
    recorded: plan from a log. Raises ConfigurationError for settings that give no trajectory.
    """
    return BUILDERS[type(settings)](settings, Context(home, folder, period_s, recorded))
