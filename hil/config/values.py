"""Types used in several sections: vectors, six values per leg, bounds, a pose."""

import math
from typing import Annotated, Literal, get_args

from pydantic import AfterValidator, Field

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
"""Six coordinates of a pose: position and rotation vector."""
SixPositive = Annotated[list[Positive], Field(min_length=6, max_length=6)]
ThreePositive = Annotated[list[Positive], Field(min_length=3, max_length=3)]
SixNonNegative = Annotated[list[NonNegative], Field(min_length=6, max_length=6)]


def _at_most_half_a_turn(vector: Vector3) -> Vector3:
    angle = math.hypot(*vector)
    if angle > 180 * (1 + 1e-12):
        raise ValueError(
            f"the rotation is more than half a turn, allowed: at most 180 deg, given: {angle:g} deg"
        )
    return vector


RotationVector = Annotated[Vector3, AfterValidator(_at_most_half_a_turn)]


class Pose(Section):
    """Pose of the platform: position of its origin in the base frame, and rotation vector."""

    position_m: Vector3
    rotation_vector_deg: RotationVector = (0.0, 0.0, 0.0)
