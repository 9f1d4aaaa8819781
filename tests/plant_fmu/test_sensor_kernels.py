"""Kernels of the tracker against SciPy's rotations: any attitude, and angles near 0 and near 180 degrees."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drivers.rotations import rotation_vector_kernel, turn

ANGLES = [0.0, 1e-12, 1e-9, 9.9e-5, 1.01e-4, 1e-2, 1.0, 2.0, 3.0, np.pi - 1e-6]


@pytest.mark.parametrize("angle", ANGLES)
@pytest.mark.parametrize("seed", range(20))
def test_rotation_vector_of_a_sensor_sample_agrees_with_scipy_for_any_axis_and_angle(angle, seed):
    axis = np.random.default_rng(seed).standard_normal(3)
    r = angle * axis / np.linalg.norm(axis)
    other = 1e-3 * np.random.default_rng(seed + 100).standard_normal(3)
    expected = (Rotation.from_rotvec(other) * Rotation.from_rotvec(r)).as_rotvec()
    found = rotation_vector_kernel(turn(other, Rotation.from_rotvec(r).as_matrix()))
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-13 if angle < 3.1 else 1e-9)
