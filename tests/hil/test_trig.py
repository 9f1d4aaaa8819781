"""Sine and cosine without libm: accurate, and the same bits whatever the C library picks."""

import math

import numpy as np
import pytest

from hil.mathematics.trigonometry import sincos


@pytest.mark.parametrize("reach", [0.8, 7.0, 100.0, 1e6])
def test_sine_and_cosine_are_within_1e_15_of_libm(reach):
    octants = np.arange(-40, 41) * (math.pi / 4)
    near = [np.nextafter(octants, -np.inf), octants, np.nextafter(octants, np.inf)]
    for x in np.concatenate([np.linspace(-reach, reach, 4001), *near]):
        s, c = sincos(float(x))
        assert abs(s - math.sin(x)) <= 1e-15
        assert abs(c - math.cos(x)) <= 1e-15


def test_small_angles_keep_full_relative_accuracy():
    for x in (1e-300, 1e-20, 1e-8, 1e-3):
        s, c = sincos(x)
        assert s == pytest.approx(math.sin(x), rel=3e-16, abs=0)
        assert c == pytest.approx(math.cos(x), rel=3e-16, abs=0)
