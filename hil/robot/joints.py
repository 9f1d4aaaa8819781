"""Joint centres on a circle, from a radius and angles."""

import math
from collections.abc import Sequence
from typing import Literal

import numpy as np

from drivers.arrays import Array
from hil.mathematics.rotations import rotation_from_vector

PairsBegin = Literal["first_leg", "second_leg"]


def _about_z(angle_deg: float) -> tuple[float, float]:
    R = rotation_from_vector(np.array([0.0, 0.0, math.radians(math.remainder(angle_deg, 360.0))]))
    return float(R[0, 0]), float(R[1, 0])


def on_circle(radius: float, angles_deg: Sequence[float], z: float = 0.0) -> Array:
    """Joint centres (n, 3) m on a circle about the z axis: (r cos, r sin, z), angles from x towards y."""
    return np.array([[radius * c, radius * s, z] for c, s in map(_about_z, angles_deg)])


def chord(radius: float, half_angle_deg: float) -> float:
    """Distance, m, between the joints at +half_angle_deg and -half_angle_deg on a circle: 2 r sin(angle)."""
    return 2 * radius * _about_z(half_angle_deg)[1]


def in_pairs(
    radius: float,
    centres_deg: Sequence[float],
    spacing: float,
    z: float = 0.0,
    begin: PairsBegin = "first_leg",
) -> Array:
    """Joint centres of pairs on a circle, (2 n, 3) m in leg order.

    The joints of a pair lie at exp(centre [z]x) (sqrt(r^2 - d^2/4), -+d/2, z), d the spacing. The joint at
    the smaller angle comes first.

    radius, spacing, z: m; spacing is the distance between the two joints of a pair, 0 where they coincide.
    centres_deg: (n,) direction of each pair, from x towards y.
    begin: `first_leg`: the pairs are legs 0 and 1, 2 and 3, 4 and 5. `second_leg`: the pairs are legs
    1 and 2, 3 and 4, 5 and 0, as on the platform of a robot whose base pairs begin with leg 0.
    """
    half = spacing / 2
    depth = math.sqrt(radius**2 - half**2)
    rows = [
        [c * depth - s * side, s * depth + c * side, z]
        for c, s in map(_about_z, centres_deg)
        for side in (-half, half)
    ]
    return np.array(rows if begin == "first_leg" else [rows[-1], *rows[:-1]])
