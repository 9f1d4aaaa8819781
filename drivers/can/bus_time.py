"""Bus time: how long a frame occupies the wire.

Worst-case frame lengths, ISO 11898-1, with interframe space (3 bits) and as many stuff bits as the
stuffed region of g bits can hold, floor((g - 1) / 4):

Classic, 11-bit identifier, n data bytes: 44 + 8n + 3 + floor((34 + 8n - 1) / 4)
    n = 8: 44 + 64 + 3 + floor(97 / 4) = 111 + 24 = 135 bits
    n = 4: 44 + 32 + 3 + floor(65 / 4) = 79 + 16 = 95 bits
Classic, 29-bit identifier: 64 + 8n + 3 + floor((54 + 8n - 1) / 4);  n = 8: 131 + 29 = 160 bits

CAN FD with bit-rate switch, 11-bit identifier. At the arbitration rate: SOF 1, identifier 11, RRS, IDE, FDF,
res, BRS = 17 bits (29-bit identifier: 36), at most floor(16 / 4) = 4 of the stuff bits (36: 8), then CRC
delimiter, ACK, ACK delimiter, EOF 7, interframe 3 = 13. At the data rate: ESI 1, DLC 4, data 8n, the stuff
bits that are left of floor((17 + 5 + 8n - 1) / 4), stuff count 4, CRC 17 (n <= 16) or 21, and the fixed
stuff bits, one before the stuff count and one after every fourth bit: 1 + floor(21 / 4) = 6 or
1 + floor(25 / 4) = 7.
    n = 12: 34 bits + (5 + 96 + 25 + 4 + 17 + 6 = 153 bits);  at 1M/5M 34 + 30.6 = 64.6 us
    n = 32: 34 bits + (5 + 256 + 65 + 4 + 21 + 7 = 358 bits);  at 1M/5M 34 + 71.6 = 105.6 us
BRS and CRC delimiter straddle the two rates; both count at the slow one. Without the switch all bits do.

Fewest bits: only the fixed stuff bits; BRS and CRC delimiter together count as one bit at each rate.
    classic, 11-bit identifier, n = 8: 44 + 64 + 3 = 111 bits;  29-bit: 131 bits
    CAN FD, n = 12: 29 bits + (5 + 96 + 4 + 17 + 6 + 1 = 129 bits);  at 1M/5M 29 + 25.8 = 54.8 us

Error frame: two superposed flags 12, delimiter 8, interframe 3 = 23 bits.
"""

from __future__ import annotations

from bisect import bisect_left
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

from drivers.errors import BusError
from drivers.protocol import BRS, ERROR, EXTENDED, FD, REMOTE

if TYPE_CHECKING:
    from drivers.config import BusSettings

FD_LENGTHS = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)
"""Data lengths that CAN FD can carry, bytes."""
INTERFRAME = 3
"""Bits of interframe space after every frame."""
ERROR_FRAME_BITS = 12 + 8 + INTERFRAME


class BitTiming(NamedTuple):
    """Arbitration and data bit rates of a CAN bus, bit/s."""

    bitrate: int
    """bit/s in the arbitration phase (and of all classic frames)."""
    data_bitrate: int
    """bit/s of the data phase of CAN FD frames with bit-rate switch."""

    @classmethod
    def of(cls, bus: BusSettings) -> BitTiming:
        """Bit rates set in the section `bus` of the configuration."""
        return cls(bus.bitrate_bit_s, bus.data_bitrate_bit_s)


def frame_bits(length: int, flags: int, *, least: bool = False) -> tuple[int, int]:
    """(bits at the arbitration rate, bits at the data rate) of the longest frame, with interframe space.

    length: data bytes; flags as in `Frame`; least: count the fewest bits instead (only fixed stuff bits). The
    module docstring has the formulas. Raises BusError for a length that no CAN frame has.
    """
    if flags & ERROR:
        return ERROR_FRAME_BITS, 0
    extended = bool(flags & EXTENDED)
    if not flags & FD:
        if not 0 <= length <= 8:
            raise BusError(f"a classic CAN frame carries 0 to 8 bytes, not {length}: use bus.layout: fd")
        data = 0 if flags & REMOTE else 8 * length
        stuffed = (54 if extended else 34) + data
        return stuffed + (0 if least else (stuffed - 1) // 4) + 10 + INTERFRAME, 0
    if not 0 <= length <= 64:
        raise BusError(f"a CAN FD frame carries 0 to 64 bytes, not {length}: split it")
    padded = FD_LENGTHS[bisect_left(FD_LENGTHS, length)]
    slow = 36 if extended else 17
    fast = 5 + 8 * padded
    slow_stuff = 0 if least else (slow - 1) // 4
    fast_stuff = 0 if least else (slow + fast - 1) // 4 - slow_stuff
    check = 4 + (17 if padded <= 16 else 21)
    slow += slow_stuff + 1 + 2 + 7 + INTERFRAME
    fast += fast_stuff + check + 1 + check // 4
    if not flags & BRS:
        return slow + fast, 0
    return (slow - 1, fast + 1) if least else (slow, fast)


@lru_cache(maxsize=1024)
def frame_time_ns(length: int, flags: int, timing: BitTiming, *, least: bool = False) -> int:
    """Longest time that a frame holds the wire, ns rounded up, with interframe space.

    least: shortest time from the end of one frame to the end of the next, ns rounded down; the interframe
    space lies between them. Raises BusError for a length that no CAN frame has.
    """
    slow, fast = frame_bits(length, flags, least=least)
    f, fd = timing
    bit_ns, per = (slow * fd + fast * f) * 1_000_000_000, f * fd
    return bit_ns // per if least else -(-bit_ns // per)
