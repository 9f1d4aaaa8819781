"""Types used in several sections: vectors, six values per leg, bounds, a pose."""

import math
from typing import Annotated, Literal, Self, get_args

from pydantic import AfterValidator, Field, model_validator

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


class Orientation(Section):
    """Rotation of a frame: as a rotation vector, or as roll, pitch and yaw."""

    rotation_vector_deg: RotationVector = (0.0, 0.0, 0.0)
    roll_pitch_yaw_deg: Vector3 | None = Field(default=None, exclude=True)
    """Instead of rotation_vector_deg: R = Rz(yaw) Ry(pitch) Rx(roll), about z, the new y, the new x."""

    @model_validator(mode="after")
    def _one_rotation(self) -> Self:
        """Replace roll, pitch and yaw by the rotation vector: all else reads only that."""
        if self.roll_pitch_yaw_deg is not None:
            if "rotation_vector_deg" in self.model_fields_set:
                raise ValueError("allowed: either rotation_vector_deg or roll_pitch_yaw_deg")
            vector = rotation_vector_deg(*self.roll_pitch_yaw_deg)
            object.__setattr__(self, "rotation_vector_deg", vector)
            object.__setattr__(self, "roll_pitch_yaw_deg", None)
            self.model_fields_set.add("rotation_vector_deg")
        return self


def rotation_vector_deg(roll: float, pitch: float, yaw: float) -> Vector3:
    """Rotation vector of R = Rz(yaw) Ry(pitch) Rx(roll), all in degrees; at most half a turn.

    By the unit quaternion w + x i + y j + z k, w >= 0: r = 2 atan2(|v|, w) v / |v|, v = (x, y, z).
    """
    (cr, sr), (cp, sp), (cy, sy) = (
        (math.cos(a), math.sin(a)) for a in (math.radians(a) / 2 for a in (roll, pitch, yaw))
    )
    w = cr * cp * cy + sr * sp * sy
    v = (sr * cp * cy - cr * sp * sy, cr * sp * cy + sr * cp * sy, cr * cp * sy - sr * sp * cy)
    norm = math.copysign(math.hypot(*v), w)
    turn = 0.0 if norm == 0.0 else math.degrees(2 * math.atan2(abs(norm), abs(w))) / norm
    return v[0] * turn, v[1] * turn, v[2] * turn


class Pose(Orientation):
    """Pose of the platform: position of its origin in the base frame, and rotation."""

    position_m: Vector3
