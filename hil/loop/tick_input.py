"""The input of a tick, the columns of its record that store it, and the checksum of its frames."""

import struct
from collections.abc import Sequence
from typing import Any

import numpy as np

from drivers.arrays import Rows
from drivers.compiled.compiler import helper
from drivers.errors import LogError
from drivers.signals import BusState
from drivers.tick_columns import INPUT_COLUMNS, INPUT_ELEMENTS
from hil.signals import Operator, Order, SetPoint, TickInput

_INPUT = struct.Struct(f"<{INPUT_ELEMENTS}q")
"""The columns of TickInput are the first ones of the row, in the order of INPUT_COLUMNS."""
_STATES = {int(state): state for state in BusState}


def put_input(tick: Any, inp: TickInput) -> None:
    """Write a tick's input to the input columns of its record."""
    _INPUT.pack_into(
        tick, 0, inp.tick,
        inp.t_ns, inp.lateness_ns, inp.skipped, inp.stretched_ns, inp.sync_skew_ns, inp.sends_failed,
        inp.bus_errors, inp.bus_off, inp.bus_overflow, inp.bus_state, inp.recorder_alive,
        inp.recorder_dropped, inp.compute_ns, *inp.latch_ns,
    )  # fmt: skip


def input_of(
    row: Any,
    frames: Rows,
    operator: Sequence[int] = (),
    setpoints: tuple[SetPoint, ...] = (),
    orders: tuple[Order, ...] = (),
) -> TickInput:
    """Input of a tick from its recorded row; the other arguments are stored in no column.

    Raises LogError for values that no cycle writes.
    """
    numbers = _INPUT.unpack_from(row)
    given: dict[str, Any] = dict(zip(INPUT_COLUMNS, numbers, strict=False))  # latch_ns, the last one, is six
    tick, alive, state = numbers[0], given["recorder_alive"], _STATES.get(given["bus_state"])
    if alive not in (0, 1):
        raise LogError(f"the row of tick {tick} is damaged: {alive} is not a valid recorder_alive")
    if state is None:
        raise LogError(f"the row of tick {tick} is damaged: {given['bus_state']} is not a valid BusState")
    try:
        words = tuple(map(Operator, operator))
    except ValueError as error:
        raise LogError(f"the row of tick {tick} is damaged: {error}") from None
    given |= {"bus_state": state, "recorder_alive": alive == 1, "latch_ns": numbers[len(INPUT_COLUMNS) - 1 :]}
    return TickInput(**given, frames=frames, operator=words, setpoints=setpoints, orders=orders)


_POLYNOMIAL = 0xEDB88320
_ALL_ONES = 0xFFFFFFFF


def _tables() -> Any:
    """CRC table (8, 256): the register after a byte, followed by 0 to 7 zero bytes."""
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
    """CRC register after the eight bytes of a 64-bit word."""
    low = np.uint64(word) ^ np.uint64(register)
    after = np.uint32(0)
    for k in range(8):
        after ^= _TABLES[7 - k, low >> np.uint64(8 * k) & np.uint64(0xFF)]
    return after


@helper
def crc32(frames: Any) -> int:
    """CRC-32 (ISO 3309, as in zlib) of FRAME records.

    Of each it covers, little-endian: time (8 bytes), identifier (4), flags with the bus in the high byte (2),
    number of data bytes (2), and the data.
    """
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
