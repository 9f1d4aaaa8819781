"""From the configuration's `reference` section to a trajectory."""

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
from hil.trajectory.path import HoldTrajectory, Trajectory, axis_limits, checked_words
from hil.trajectory.sampled import sampled_trajectory
from hil.trajectory.sinusoids import SinusoidTrajectory
from hil.trajectory.time_optimal import plan, planned_trajectory
from hil.trajectory.waypoints import waypoint_trajectory

UNTIMED_S = 1e-3
"""Period of a live reference that is only looked at."""


class Context(NamedTuple):
    """What a trajectory is built with, beside its own settings."""

    home: Pose
    """The platform's home pose: default of hold, sinusoids, multisine and live."""
    folder: Path | None
    """That of the configuration file, to which a CSV path is relative; without one a CSV is refused."""
    period_s: float
    """Of the loop."""
    plan: bytes | None
    """The plan that a log carries; None plans anew."""


def _hold(settings: HoldReference, context: Context) -> Trajectory:
    chi = checked_words(settings.pose or context.home, "reference.pose")
    return HoldTrajectory(chi[:3], rotation_from_vector(chi[3:]), settings.duration_s)


def _sampled(settings: SampledReference, context: Context) -> Trajectory:
    if context.folder is None:
        raise ConfigurationError(
            f"reference.path: {settings.path} needs the configuration's folder; there is none here."
        )
    return sampled_trajectory(settings, context.folder)


def _live(settings: LiveReference, context: Context) -> Trajectory:
    chi = checked_words(settings.start or context.home, "reference.start")
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
"""Settings model -> builder."""


def build_trajectory(
    settings: ReferenceSettings,
    home: Pose,
    folder: Path | None,
    period_s: float = UNTIMED_S,
    recorded: bytes | None = None,
) -> Trajectory:
    """Return the trajectory of the `reference` section.

    home: the platform's home pose; folder: that of the configuration file; period_s: of the loop; recorded:
    the plan in a log. Raises ConfigurationError on what cannot be a trajectory.
    """
    return BUILDERS[type(settings)](settings, Context(home, folder, period_s, recorded))
