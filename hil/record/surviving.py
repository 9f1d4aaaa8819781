"""The records of a damaged file: goes on behind the damage, and says which bytes gave nothing.

A record counts where a sound one follows, or where its own checksum holds. Else the next place is looked for
at which two sound records stand behind each other.
"""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, NamedTuple

from mcap.opcode import Opcode
from mcap.records import Attachment, Chunk

from drivers.errors import LogError
from drivers.regular_file import open_regular
from hil.record.mcap_file import MAGIC, record_bytes
from hil.record.mcap_read import HEAD, OPCODES, Record, decompress, longest

_BEGIN = re.compile(rb"(?=[\x01-\x0f][\s\S]{4}\x00{4})")
"""A known opcode and a length below 4 GiB."""
_WINDOW = 1 << 20


class Lost(NamedTuple):
    """Bytes of a file that are no record."""

    start: int
    stop: int


def surviving(path: Path) -> Iterator[Record | Lost]:
    """Yield the records of data section and index in their order, and what lies between them.

    A record whose end is cut off comes last and is not complete.

    Raises OSError.
    """
    with open_regular(path) as file:
        size = file.seek(0, 2)
        at = len(MAGIC)
        while at + HEAD.size <= size:
            opcode, length = _head(file, at)
            end, record, stop = at + HEAD.size + length, None, size
            if opcode == Opcode.FOOTER and length == 20:
                return
            if _plausible(opcode, length):
                content = _read(file, at + HEAD.size, min(length, size - at - HEAD.size))
                record = Record(opcode, at, content, complete=end <= size)
                stop = min(end, size)
            further = None
            if record is None or not (record.complete and (_sound(file, end, size) or _verified(record))):
                further = _next(file, at + 1, stop, size)
            if record is not None and further is None:
                yield record
                at = end
            else:
                stop = size if further is None else further
                yield Lost(at, stop)
                at = stop
        if at < size:
            yield Lost(at, size)


def _head(file: BinaryIO, at: int) -> tuple[int, int]:
    opcode, length = HEAD.unpack(_read(file, at, HEAD.size))
    return int(opcode), int(length)


def _read(file: BinaryIO, at: int, length: int) -> bytes:
    file.seek(at)
    return file.read(length)


def _plausible(opcode: int, length: int) -> bool:
    return opcode in OPCODES and length <= longest(opcode)


def _sound(file: BinaryIO, at: int, size: int) -> bool:
    """Return whether the file ends there, or something stands there that may be a record within it."""
    if at + HEAD.size > size:
        return True
    opcode, length = _head(file, at)
    return _plausible(opcode, length) and at + HEAD.size + length <= size


def _verified(record: Record) -> bool:
    """Return whether a record's own checksum says that it is whole."""
    try:
        found = record.parse()
        if isinstance(found, Chunk):
            decompress(found)
            return bool(found.uncompressed_crc) and record_bytes(found) == record.whole
        return isinstance(found, Attachment) and record_bytes(found) == record.whole
    except LogError:
        return False


def _next(file: BinaryIO, start: int, stop: int, size: int) -> int | None:
    """Return the first place from `start` to before `stop` at which two sound records begin; None without."""
    at = start
    while at < stop:
        window = _read(file, at, min(_WINDOW, stop - at) + HEAD.size - 1)
        for found in _BEGIN.finditer(window):
            place = at + found.start()
            opcode, length = HEAD.unpack_from(window, found.start())
            end = place + HEAD.size + length
            if place < stop and _plausible(opcode, length) and end <= size and _sound(file, end, size):
                return place
        at += _WINDOW
    return None
