"""Rotation vectors in motion."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hil.mathematics.rotations import relative_rotation, rotation_vector_rate


@pytest.mark.parametrize("angle", [0.0, 1e-8, 1e-3, 0.5, 2.0, 3.1])
def test_the_rate_of_a_rotation_vector_is_that_of_the_turning_matrix(angle):
    """Central difference over exp([t w]x) R by scipy; the error of the difference is below 1e-8."""
    random = np.random.default_rng(11)
    axis, omega = random.normal(size=3), random.normal(size=3)
    r = angle * axis / np.linalg.norm(axis)
    h = 1e-5
    ahead, behind = ((Rotation.from_rotvec(t * omega) * Rotation.from_rotvec(r)).as_rotvec() for t in (h, -h))
    np.testing.assert_allclose(rotation_vector_rate(r, omega), (ahead - behind) / (2 * h), rtol=0, atol=1e-8)


@pytest.mark.parametrize("angle", [0.2, 1.7, 3.1, 4.5])
def test_the_rate_of_a_rotation_vector_is_the_closed_form_with_a_cotangent(angle):
    """dr = w - r x w / 2 + (1 - (a/2) cot(a/2)) / a^2 r x (r x w), beyond half a turn as well."""
    r, omega = angle * np.array([0.6, 0.0, -0.8]), np.array([0.3, -1.0, 0.7])
    D = (1 - angle / 2 / np.tan(angle / 2)) / angle**2
    turned = np.cross(r, omega)
    expected = omega - turned / 2 + D * np.cross(r, turned)
    np.testing.assert_allclose(rotation_vector_rate(r, omega), expected, rtol=0, atol=1e-13)


def test_the_relative_rotation_is_the_shortest_turn_in_the_base_frame():
    random = np.random.default_rng(2)
    for _ in range(20):
        A, B = Rotation.random(2, random)
        matrices = [np.ascontiguousarray(x.as_matrix()) for x in (A, B)]
        np.testing.assert_allclose(relative_rotation(*matrices), (B * A.inv()).as_rotvec(), atol=1e-12)
