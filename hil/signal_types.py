"""The signals as arguments of kernels: ``kernel(*MEASUREMENT, *STATE)`` is called with both unpacked.

The order is that of the fields in `drivers.signals` and `hil.signals`.
"""

from __future__ import annotations

from drivers.compiled.compiler import FLAGS, INTEGER, INTEGERS, MATRIX, REAL, VECTOR

MEASUREMENT = (VECTOR, VECTOR, VECTOR, INTEGERS, INTEGERS, INTEGERS, INTEGER, INTEGER, FLAGS)
STATE = (VECTOR, VECTOR, VECTOR, MATRIX, VECTOR, MATRIX, INTEGER, REAL, VECTOR)
REFERENCE = (VECTOR, MATRIX, VECTOR, VECTOR, VECTOR, VECTOR, VECTOR, REAL)
