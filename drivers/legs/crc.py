"""The end-to-end checks of the own protocol: SAE J1850 CRC-8, and a CRC-16 where a frame is longer.

Both begin with the two bytes of the identifier, low byte first: a frame that was sent or routed under another
one fails. CRC-8 finds any two wrong bits in up to 255 (Hamming distance 3); with its 224 bits, check included
240, the command of layout fd has a CRC-16 that finds any four (Hamming distance 5). Polynomial 0x5935 is that
of P. Koopman's tables (0xAC9A in his notation, the best of 16 bits for up to 241 bits of data); CCITT's
0x1021 finds three. `tests/drivers/test_crc.py` counts it out.
"""

from typing import Any

import numpy as np

from drivers.arrays import Ints
from drivers.compiled.compiler import DATA, INTEGER, helper, kernel

POLYNOMIAL = 0x1D
"""x^8 + x^4 + x^3 + x^2 + 1; start and final XOR 0xFF; the check value of b"123456789" is 0x4B."""
POLYNOMIAL_16 = 0x5935
"""x^16 + x^14 + x^12 + x^11 + x^8 + x^5 + x^4 + x^2 + 1; start 0xFFFF, no final XOR; the check value of
b"123456789" is 0x772B, that of CRC-16/M17."""


def _table(polynomial: int, bits: int) -> Ints:
    """Return byte * x^bits modulo a polynomial of that degree, for each byte."""
    register = np.arange(256) << bits - 8
    for _ in range(8):
        register = register << 1 ^ (register >> bits - 1) * (1 << bits | polynomial)
    return register


_TABLE, _TABLE_16 = _table(POLYNOMIAL, 8).astype(np.uint8), _table(POLYNOMIAL_16, 16)


@helper
def check_of(identifier: int, data: Any, size: int, width: int) -> int:
    """Return the check of an identifier and data[:size], `width` bytes long, most significant bit first."""
    if width == 1:
        register = int(_TABLE[_TABLE[0xFF ^ (identifier & 0xFF)] ^ (identifier >> 8)])
        for k in range(size):
            register = int(_TABLE[register ^ int(data[k])])
        return register ^ 0xFF
    register = 0xFFFF
    for k in range(-2, size):
        byte = int(data[k]) if k >= 0 else identifier >> 8 * (k + 2) & 0xFF
        register = ((register << 8) & 0xFFFF) ^ _TABLE_16[(register >> 8) ^ byte]
    return register


@helper
def intact(frame: Any) -> bool:
    """Tell whether a record of FRAME, not empty, ends in its CRC-8."""
    identifier: Any = np.int64(frame.id)
    last: Any = np.int64(frame.length) - 1
    return bool(check_of(identifier, frame.data, last, 1) == frame.data[last])


@kernel(INTEGER, DATA, INTEGER)
def check(identifier: int, data: Any, width: int) -> int:
    """Return the check of bytes, from Python; see `check_of`."""
    return check_of(identifier, data, len(data), width)
