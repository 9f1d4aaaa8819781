"""End-to-end checks of frames of the protocol `legs`: SAE J1850 CRC-8, and a CRC-16 in longer frames.

Both begin with the two bytes of the identifier, low byte first: a frame sent or routed under another
identifier fails. CRC-8 detects any two wrong bits in up to 255 (Hamming distance 3). The command of layout fd
has 224 bits, with its check 240; its CRC-16 detects any four wrong bits (Hamming distance 5). Polynomial
0x5935 is from P. Koopman's tables (0xAC9A in his notation, the best of 16 bits for up to 241 bits of data);
CCITT's 0x1021 detects three. `tests/drivers/test_crc.py` counts this out.
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
    """CRC table: byte * x^bits modulo the generator polynomial of degree `bits`, for each byte."""
    register = np.arange(256) << bits - 8
    for _ in range(8):
        register = register << 1 ^ (register >> bits - 1) * (1 << bits | polynomial)
    return register


_TABLE, _TABLE_16 = _table(POLYNOMIAL, 8).astype(np.uint8), _table(POLYNOMIAL_16, 16)


@helper
def check_of(identifier: int, data: Any, size: int, width: int) -> int:
    """CRC of an identifier and data[:size]: `width` bytes (1: CRC-8, 2: CRC-16), high bit first."""
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
    """True if a FRAME record is not empty and ends in its valid CRC-8."""
    identifier: Any = np.int64(frame.id)
    last: Any = np.int64(frame.length) - 1
    return bool(check_of(identifier, frame.data, last, 1) == frame.data[last])


@kernel(INTEGER, DATA, INTEGER)
def check(identifier: int, data: Any, width: int) -> int:
    """CRC of an identifier and data, `width` bytes (1 or 2), for Python code; see `check_of`."""
    return check_of(identifier, data, len(data), width)
