"""Rule: every number is finite.

Rule of the room: see `hil.safety`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from drivers.compile_cache import helper


@helper
def all_finite(x: NDArray[np.float64]) -> bool:
    """Tell whether no element of x, of any shape, is infinite or not a number."""
    for value in x.flat:  # noqa: SIM110 - compiled
        if not abs(value) < np.inf:
            return False
    return True
