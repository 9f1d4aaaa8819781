"""The arrays that everybody names: float64, int64, flags, bytes, rows of a table."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
Ints = NDArray[np.int64]
Flags = NDArray[np.bool_]
Bytes = NDArray[np.uint8]
Rows = NDArray[np.void]
"""Elements of a structured type: rows of a log, records of a tick."""
