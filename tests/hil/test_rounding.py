"""Numbers that are proposed as limits: of few digits, and never on the wrong side of what they were made of."""

from __future__ import annotations

import numpy as np
import pytest

from hil.mathematics.rounding import lowered, raised

NUMBERS = [*np.geomspace(1e-4, 1e5, 400).tolist(), 1.0, 0.011, 0.0101, 9.91, 99.9, 1234.0]


@pytest.mark.parametrize("digits", [1, 2, 3])
def test_raised_and_lowered_numbers_are_the_nearest_of_few_digits(
    digits,
):
    for x in NUMBERS:
        above, below = raised(x, digits), lowered(x, digits)
        assert below <= x * (1 + 1e-9)
        assert above >= x * (1 - 1e-9)
        for each in (above, below):
            assert float(f"{each:.{digits - 1}e}") == each
        assert above - below <= 1.001 * 10.0 ** (np.floor(np.log10(x)) - digits + 1)
