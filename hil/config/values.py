"""What several sections are made of: vectors, six per leg, bounds, a pose."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from drivers.config import Section

Vector3 = tuple[float, float, float]
Matrix3 = tuple[Vector3, Vector3, Vector3]
Six = Annotated[list[float], Field(min_length=6, max_length=6)]
SixVectors = Annotated[list[Vector3], Field(min_length=6, max_length=6)]
Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
JointAngle = Annotated[float, Field(gt=0, le=180)]
LegSpin = Literal["none", "universal"]
SixPositive = Annotated[list[Positive], Field(min_length=6, max_length=6)]
ThreePositive = Annotated[list[Positive], Field(min_length=3, max_length=3)]
SixNonNegative = Annotated[list[NonNegative], Field(min_length=6, max_length=6)]


def largest(gain: float | list[float]) -> float:
    """Return the largest gain of six legs, or the one of all."""
    return max(gain) if isinstance(gain, list) else gain


class Pose(Section):
    """Platform pose: origin in the base frame and rotation vector."""

    position_m: Vector3
    rotation_vector_deg: Vector3 = (0.0, 0.0, 0.0)
