"""Section `reference`: settings of each kind of reference trajectory, selected by `type`."""

from typing import Annotated, Literal

from pydantic import Field

from drivers.section import Section
from hil.config.values import Axis, Pose, Positive

LONGEST_S = 86_400.0
"""Longest duration without repetition: the whole reference is checked before it runs."""
LONGEST_HOLD_S = 1e9
"""Longest hold, as the longest --duration; without an end it holds until it is stopped."""
MOST_PERIODS = 1_000_000
MOST_POINTS = 10_000
"""Most points of a path in the configuration; a longer path belongs in a CSV file."""
MOST_PLANNED = 1000
"""Most poses of a time-optimal path."""
MOST_LINES = 1000
"""Most sinusoids of a sum; each is evaluated at each tick."""
MOST_AXES = 24
"""Most groups of lines in a multisine."""
Periods = Annotated[int, Field(ge=1, le=MOST_PERIODS)]
Moment = Annotated[float, Field(ge=0, le=LONGEST_S)]
Duration = Annotated[float, Field(gt=0, le=LONGEST_S)]


class Evaluated(Section):
    """Keys of every reference whose motion is known before the run."""

    evaluation: Literal["online", "offline"] = "online"
    """No effect: samples are computed at each tick."""


class HoldReference(Evaluated):
    """Reference at rest at one pose."""

    type: Literal["hold"]
    pose: Pose | None = None
    """Default: home."""
    duration_s: Annotated[float, Field(gt=0, le=LONGEST_HOLD_S)] | None = None
    """Default: until stopped."""


class Waypoint(Pose):
    """One way-point: pose at a time after the start."""

    t_s: Moment


class WaypointReference(Evaluated):
    """Path through way-points at given times, with position and rotation vector interpolated."""

    type: Literal["waypoints"]
    interpolation: Literal["cubic", "quintic", "minimum_jerk"] = "quintic"
    """cubic and quintic rest at every point, minimum_jerk only at the first and the last one."""
    points: Annotated[list[Waypoint], Field(min_length=2, max_length=MOST_POINTS)]
    periods: Periods | None = 1
    """Number of passes through the list; null repeats it for ever."""


AxisLimit = Positive | tuple[Positive, Positive, Positive]
"""One value for all three axes, or one per axis."""


class AxisLimits(Section):
    """Largest velocity, acceleration and jerk of position and rotation vector, component by component.

    The angular velocity is at most the norm of the three rates of the rotation vector.
    """

    velocity_m_s: AxisLimit
    velocity_deg_s: AxisLimit
    acceleration_m_s2: AxisLimit
    acceleration_deg_s2: AxisLimit
    jerk_m_s3: AxisLimit
    jerk_deg_s3: AxisLimit


class TimeOptimalReference(Evaluated):
    """From pose to pose in the shortest time within limits, at rest at each; the times are computed."""

    type: Literal["time_optimal"]
    points: Annotated[list[Pose], Field(min_length=2, max_length=MOST_PLANNED)]
    limits: AxisLimits
    periods: Periods | None = 1
    """Number of passes through the list; null repeats it for ever."""


class Sinusoid(Section):
    """amplitude * sin(2 pi frequency t + phase) on one axis."""

    axis: Axis
    amplitude: float
    """In the unit of the axis."""
    frequency_Hz: Positive
    phase_rad: float = 0.0


class SinusoidReference(Evaluated):
    """Sum of sinusoids about a centre pose, faded in and out by quintics."""

    type: Literal["sinusoids"]
    centre: Pose | None = None
    """Default: home."""
    components: Annotated[list[Sinusoid], Field(min_length=1, max_length=MOST_LINES)]
    ramp_s: Moment = 1.0
    duration_s: Duration


class MultisineAxis(Section):
    """Sinusoids (lines) of equal amplitude on one axis, spread over a band of frequencies."""

    axis: Axis
    band_Hz: tuple[Positive, Positive]
    """Evenly spread lines from the first to the second frequency."""
    lines: Annotated[int, Field(ge=1, le=MOST_LINES)]
    amplitude: Positive
    """Largest deviation from the centre, in the unit of the axis."""
    phases: Literal["schroeder", "random"] = "schroeder"
    seed: int = 0
    """Seed of random phases."""


class MultisineReference(Evaluated):
    """Sums of sinusoids at multiples of 1/period_s, for identification; faded in before and out after."""

    type: Literal["multisine"]
    centre: Pose | None = None
    """Default: home."""
    axes: Annotated[list[MultisineAxis], Field(min_length=1, max_length=MOST_AXES)]
    """No two axes share a frequency."""
    period_s: Duration
    periods: Periods = 1
    """Whole periods between the ramps."""
    ramp_s: Moment = 1.0


class SampledReference(Evaluated):
    """Cubic spline through a CSV file: t_s, x_m, y_m, z_m, rotation vector rx_deg, ry_deg, rz_deg."""

    type: Literal["sampled"]
    path: str
    """Relative to the configuration file."""
    periods: Periods = 1


class LiveReference(Section):
    """Set-points received during the run, approached within limits on each axis; holds at the last one."""

    type: Literal["live"]
    start: Pose | None = None
    """Pose before the first set-point. Default: home."""
    limits: AxisLimits


ReferenceSettings = Annotated[
    HoldReference
    | WaypointReference
    | TimeOptimalReference
    | SinusoidReference
    | MultisineReference
    | SampledReference
    | LiveReference,
    Field(discriminator="type"),
]
