"""Numbers that are proposed as limits: few digits, and on the safe side of what they were made of."""

from __future__ import annotations

import numpy as np
import pytest

from hil.mathematics.rounding import lowered, raised

NUMBERS = [*np.geomspace(1e-4, 1e5, 400).tolist(), 1.0, 0.011, 0.0101, 9.91, 99.9, 1234.0]


@pytest.mark.parametrize("digits", [1, 2, 3])
def test_rounding_goes_to_the_next_number_of_so_many_digits_on_its_side(digits):
    for x in NUMBERS:
        above, below = raised(x, digits), lowered(x, digits)
        assert below <= x * (1 + 1e-9)
        assert above >= x * (1 - 1e-9)
        for each in (above, below):
            assert float(f"{each:.{digits - 1}e}") == each
        assert above - below <= 1.001 * 10.0 ** (np.floor(np.log10(x)) - digits + 1)


def test_a_number_of_few_digits_is_left_as_it_is():
    for k in range(10, 100):
        for scale in (1e-4, 1e-2, 1.0, 1e3):
            x = float(f"{k * scale:.2g}")
            assert (lowered(x), raised(x)) == (x, x)
