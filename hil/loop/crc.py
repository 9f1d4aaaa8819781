"""CRC-32 of the frames that a tick consumed (ISO 3309, as zlib's), over what identifies each.

Of each frame, little-endian: time (8 bytes), identifier (4), flags with the bus in the high byte (2), number
of data bytes (2), and these.
"""

from typing import Any

import numpy as np

from drivers.compiled.compiler import helper

_POLYNOMIAL = 0xEDB88320
_ALL_ONES = 0xFFFFFFFF


def _tables() -> Any:
    """Return (8, 256): the register after a byte, with 0 to 7 zero bytes behind it."""
    tables = np.zeros((8, 256), np.uint32)
    for byte in range(256):
        register = byte
        for _ in range(8):
            register = register >> 1 ^ (_POLYNOMIAL if register & 1 else 0)
        tables[0, byte] = register
    for row in range(1, 8):
        before = tables[row - 1]
        tables[row] = before >> 8 ^ tables[0, before & 0xFF]
    return tables


_TABLES = _tables()


@helper
def eight(register: Any, word: Any) -> Any:
    """Return the register after the eight bytes of a word."""
    low = np.uint64(word) ^ np.uint64(register)
    after = np.uint32(0)
    for k in range(8):
        after ^= _TABLES[7 - k, low >> np.uint64(8 * k) & np.uint64(0xFF)]
    return after


@helper
def crc32(frames: Any) -> int:
    """Return the CRC-32 of elements of FRAME."""
    register: Any = np.uint32(_ALL_ONES)
    for n in range(frames.shape[0]):
        frame = frames[n]
        size = np.int64(frame.length)
        register = eight(register, frame.t_ns)
        head = np.int64(frame.id) | np.int64(frame.flags) << 32 | np.int64(frame.bus) << 40 | size << 48
        register = eight(register, head)
        for k in range(size):
            register = _TABLES[0, (register ^ frame.data[k]) & np.uint32(0xFF)] ^ register >> np.uint32(8)
    value: int = np.int64(register ^ np.uint32(_ALL_ONES))  # type: ignore[assignment]
    return value
