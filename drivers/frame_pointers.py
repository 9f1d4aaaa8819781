"""Kernel helpers for frames and measurements, for the decoders of all drive families."""

from typing import Any

import numpy as np

from drivers.compiled.compiler import helper, record
from drivers.compiled.pointed import record_at, records_at
from drivers.frame_array import FRAME, SENT
from drivers.signals import LEGS, NEVER

MOST_OWED = 20
"""Most missing answers that a drive may still send."""
frame_at: Any = record_at(record(FRAME))
"""frame_at(address): the FRAME record at an address."""
frames_at = records_at(record(FRAME))
"""frames_at(address, count): the FRAME records at an address."""


@helper
def begin_sent(frame: Any, identifier: int, size: int, flags: int, bus: int) -> None:
    """Initialize a frame to send (FRAME record); its data bytes are 0."""
    frame.t_ns, frame.id, frame.kind = 0, identifier, SENT
    frame.length, frame.flags, frame.bus = size, flags, bus
    frame.data[:] = 0


@helper
def in_order(frames: Any) -> bool:
    """True if FRAME records are sorted by time."""
    for k in range(1, frames.shape[0]):  # noqa: SIM110 - compiled
        if frames[k].t_ns < frames[k - 1].t_ns:
            return False
    return True


@helper
def place_of(number: int, numbers: Any) -> int:
    """Index of `number` in `numbers` (6,); -1 if it is missing."""
    for k in range(LEGS):
        if number == numbers[k]:
            return k
    return -1


EVERYONE, NOBODY = -2, -1
"""Instead of a drive's node number."""


@helper
def legs_of(number: int, numbers: Any, bus: int, buses: Any) -> int:
    """Legs on a bus whose drives have node number `number` (or all, for EVERYONE), bit i: leg i.

    numbers, buses: node number and bus of each leg, (6,).
    """
    legs = 0
    for leg in range(LEGS):
        if bus == buses[leg] and number in (EVERYONE, numbers[leg]):
            legs |= 1 << leg
    return legs


@helper
def whole(data: Any, at: int, size: int = 4) -> int:
    """Integer of `size` bytes from index `at`, little-endian: unsigned up to 7 bytes, signed with 8."""
    number: Any = np.int64(0)
    for k in range(size):
        number |= np.int64(data[at + k]) << 8 * k
    return int(number)


@helper
def signed(number: int, bits: int) -> int:
    """Two's-complement value of the low `bits` bits of an integer."""
    return number - ((number >> (bits - 1)) << bits)


@helper
def code(value: float, low: float, high: float, bits: int) -> int:
    """Unsigned code of a value in a field of `bits` bits from `low` to `high`, saturated at the ends."""
    x = min(max(value, low), high)
    return int((x - low) * ((1 << bits) - 1) / (high - low))


@helper
def value(number: int, low: float, high: float, bits: int) -> float:
    """Physical value of an unsigned code in a field of `bits` bits from `low` to `high`."""
    return number * (high - low) / ((1 << bits) - 1) + low


@helper
def now_owed(owed: int, set_up: bool) -> int:
    """Answers that a drive owes from a new SYNC or poll on; one that is being set up may send two.

    For protocols whose answers carry no counter: a late answer looks like one in time, so it is the number
    that tells a late drive from two drives with one node number. Two drives that answer every SYNC exceed it
    after MOST_OWED + 1 ticks, and at once if no answer was missing. A missing answer stays owed: an answer
    that is always one SYNC late leaves the same trace as a lost one.
    """
    return owed + 1 if set_up else 2


@helper
def still_owed(owed: int, set_up: bool) -> int:
    """Answers that a drive owes at the end of a tick, at most MOST_OWED."""
    return min(max(owed, 0), MOST_OWED) if set_up else 0


@helper
def begin_measurement(last: Any, tick: Any) -> None:
    """Start a tick's measurement as the last tick's, with ages increased and error counters cleared."""
    tick.length[:] = last.length
    tick.rate[:] = last.rate
    tick.drive_force[:] = last.drive_force
    tick.drive_state[:] = last.drive_state
    tick.drive_fault[:] = last.drive_fault
    elapsed = tick.tick - last.tick if last.tick >= 0 else 1
    for leg in range(LEGS):
        tick.age[leg] = min(NEVER, last.age[leg] + elapsed)
        tick.blind[leg] = 0
    tick.rejected = tick.foreign = tick.doubled = tick.altered = 0
