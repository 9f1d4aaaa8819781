"""What several sections are made of: vectors, six per leg, bounds, a pose."""

from typing import Annotated, Literal, get_args

from pydantic import Field

from drivers.section import Section

Vector3 = tuple[float, float, float]
Matrix3 = tuple[Vector3, Vector3, Vector3]
Six = Annotated[list[float], Field(min_length=6, max_length=6)]
SixVectors = Annotated[list[Vector3], Field(min_length=6, max_length=6)]
Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
JointAngle = Annotated[float, Field(gt=0, le=180)]
LegSpin = Literal["none", "universal"]
Axis = Literal["x_m", "y_m", "z_m", "rx_deg", "ry_deg", "rz_deg"]
AXES: tuple[Axis, ...] = get_args(Axis)
"""The six words of a pose: position and rotation vector."""
SixPositive = Annotated[list[Positive], Field(min_length=6, max_length=6)]
ThreePositive = Annotated[list[Positive], Field(min_length=3, max_length=3)]
SixNonNegative = Annotated[list[NonNegative], Field(min_length=6, max_length=6)]


class Pose(Section):
    """Platform pose: origin in the base frame and rotation vector."""

    position_m: Vector3
    rotation_vector_deg: Vector3 = (0.0, 0.0, 0.0)
