"""Packs ticks into the bytes of their MCAP Message records: one kernel for any table of columns.

The recorder runs its machine code and imports neither this file nor Numba.
"""

from drivers.arrays import Bytes, Ints
from drivers.can.bus_time import FD_LENGTHS
from drivers.compiled.compiler import BYTE_POINTER, POINTER, helper
from drivers.compiled.pointed import pointed
from drivers.frame_array import FRAME
from hil.record.layout import (
    BUS,
    DIRECTION,
    DLC,
    FLAGS,
    FRAME_FLAGS,
    ID,
    INDEX,
    MAX_DATA,
    NANOS,
    SECONDS,
    TICK,
)
from hil.record.ring import RECEIVED, SENT
from hil.record.row import NAMED, UNNAMED, WHOLE
from hil.record.schema import RX, TX

_BITS = tuple(FRAME_FLAGS.values())
_FRAME_COLUMNS = FLAGS + len(_BITS)
_WORDS = FRAME.itemsize // 8
_S = 1_000_000_000


@helper
def _put(out: Bytes, at: int, value: int, size: int) -> None:
    """Store the low `size` bytes of a number, lowest first; a constant `size` compiles to one store."""
    for k in range(size):
        out[at + k] = value >> 8 * k & 0xFF


@helper
def _put_varint5(out: Bytes, at: int, value: int) -> None:
    for k in range(4):
        out[at + k] = value >> 7 * k & 0x7F | 0x80
    out[at + 4] = value >> 28 & 0x7F


@helper
def _put_bytes(out: Bytes, at: int, data: Bytes, first: int, size: int) -> None:
    for k in range(size):
        out[at + k] = data[first + k]


@helper
def _put_header(out: Bytes, at: int, tick: int, log_time: int, publish_time: int) -> None:
    """Fill tick and times, ns, into the header of the record at `at`; the template has all other bytes."""
    _put(out, at + 11, tick, 4)
    _put(out, at + 15, log_time, 8)
    _put(out, at + 23, publish_time, 8)


@helper
def _put_row(out: Bytes, at: int, rows: Ints, first: int, places: Ints, placed: int) -> None:
    """Fill a row's record at `at`, copied from the template, with the words of `rows` from `first` on."""
    for k in range(placed):
        value, place, what = rows[first + places[3 * k]], at + places[3 * k + 1], places[3 * k + 2]
        if what == WHOLE:
            _put(out, place, value, 8)
        elif what == NAMED:
            out[place] = value if 0 <= value < UNNAMED else UNNAMED
        else:
            out[place] = (value & what) != 0


@helper
def _put_frame(
    out: Bytes, at: int, items: Ints, item: int, template: Bytes, table: Ints, row: int, log_time: int
) -> int:
    """Write a frame's record without header, tick and index; the result is the length of its data.

    `row`: start of the row of its bus in the table.
    """
    start, size, data = table[row], table[row + 1], table[row + 2]
    words = items[_WORDS * item + 1]
    length: int = min(words >> 40 & 0xFF, MAX_DATA)
    _put_bytes(out, at, template, start, data)
    for k in range((length + 7) // 8):
        _put(out, at + data + 8 * k, items[_WORDS * item + 2 + k], 8)
    _put_bytes(out, at + data + length, template, start + data, size - data)
    _put(out, at + 1, size + length - 9, 8)
    out[at + data - 1] = length
    _put_varint5(out, at + table[row + SECONDS], log_time // _S)
    _put_varint5(out, at + table[row + NANOS], log_time % _S)
    _put(out, at + table[row + ID], words, 4)
    code = 0  # DLC of ISO 11898-1
    while FD_LENGTHS[code] < length:
        code += 1
    out[at + table[row + DLC]] = code
    behind = at + length
    out[behind + table[row + DIRECTION]] = RX if words >> 32 & 0xFF == RECEIVED else TX
    out[behind + table[row + BUS]] = words >> 56 & 0xFF
    for k in range(len(_BITS)):
        place = table[row + FLAGS + k]
        out[(behind if place > data else at) + place] = (words >> 48 & _BITS[k]) != 0
    return length


@helper
def _put_index(index: Ints, message: int, start: int, channel: int, log_time: int, row: int) -> None:
    at = 4 * message
    index[at], index[at + 1], index[at + 2], index[at + 3] = start, channel, log_time, row


@pointed(*[POINTER] * 4, *[BYTE_POINTER, POINTER] * 4)
def pack(
    sizes: Ints,
    when: Ints,
    rows: Ints,
    items: Ints,
    row_template: Bytes,
    row_table: Ints,
    frame_template: Bytes,
    frame_table: Ints,
    rare: Bytes,
    rare_table: Ints,
    out: Bytes,
    index: Ints,
) -> int:
    """Write the records of a batch in file order: of each tick its row, its items, its views.

    sizes : number of rows, items and rare messages; words of a row, places in its record, bytes of its
    record; number of buses; UTC of t_ns = 0, ns. Element 0 is overwritten by the number of messages.
    when : (rows + 1,) ticks, the next row included; (rows + 1,) their UTC, ns; (items,) row of each item.
    rows, items : as in the ring, in words of eight bytes.
    row_template, row_table : record of a row and `hil.record.row.RowCodec.places`.
    frame_template, frame_table : of `hil.record.layout.frame_table`.
    rare, rare_table : complete records back to back; for each (5,) its row, the item that it precedes, its
    bytes, channel, log time. Items other than frames have no other record.
    out : the records, with eight spare bytes. index : (messages + 1, 4), start in `out`, channel, log time,
    row; the last one has the start alone.
    """
    count, total, rares, words = sizes[0], sizes[1], sizes[2], sizes[3]
    placed, row_size, buses, epoch = sizes[4], sizes[5], sizes[6], sizes[7]
    at = message = item = following = taken = 0
    times = count + 1
    of_row = 2 * times
    for n in range(count + 1):
        if n < count:
            _put_bytes(out, at, row_template, 0, row_size)
            _put_header(out, at, when[n], when[times + n], when[times + n])
            _put_row(out, at, rows, n * words, row_table, placed)
            _put_index(index, message, at, row_template[9], when[times + n], n)
            at += row_size
            message += 1
        first = item
        while True:
            while (
                following < rares and rare_table[5 * following] == n and rare_table[5 * following + 1] == item
            ):
                size = rare_table[5 * following + 2]
                _put_bytes(out, at, rare, taken, size)
                _put_index(
                    index, message, at, rare_table[5 * following + 3], rare_table[5 * following + 4], n
                )
                at += size
                taken += size
                message += 1
                following += 1
            if item == total or when[of_row + item] != n:
                break
            if items[_WORDS * item + 1] >> 32 & 0xFF <= SENT:
                log_time = items[_WORDS * item] + epoch
                frame = _FRAME_COLUMNS * min(items[_WORDS * item + 1] >> 56 & 0xFF, buses - 1)
                length = _put_frame(out, at, items, item, frame_template, frame_table, frame, log_time)
                _put_header(out, at, when[n], log_time, when[times + n])
                _put(out, at + length + frame_table[frame + TICK], when[n], 8)
                _put(out, at + length + frame_table[frame + INDEX], item - first, 4)
                _put_index(index, message, at, frame_template[9], log_time, n)
                at += frame_table[frame + 1] + length
                message += 1
            item += 1
    index[4 * message] = at
    sizes[0] = message
    return 0
