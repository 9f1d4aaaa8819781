"""NumPy array types used in all packages: float64, complex128, int64, bool, uint8, structured rows."""

import ctypes
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
Ints = NDArray[np.int64]
Flags = NDArray[np.bool_]
Bytes = NDArray[np.uint8]
Rows = NDArray[np.void]
"""Elements of a structured type: rows of a log, records of a tick."""

ZERO6: Array = np.zeros(6)
ZERO6.flags.writeable = False
"""Zeros (6,), read-only: no force, no wrench, no motion."""


def array_at(address: int, count: int, dtype: Any) -> Any:
    """NumPy view (count,) of memory at an address, elements of `dtype`. For Python code, not for kernels."""
    size = count * np.dtype(dtype).itemsize
    return np.frombuffer((ctypes.c_char * size).from_address(address), dtype)
