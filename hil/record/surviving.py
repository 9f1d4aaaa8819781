"""The records of a damaged file: goes on behind the damage, and says which bytes gave nothing.

A record counts where a sound one follows, or where its own checksum holds. Else the next place is looked for
at which two sound records stand behind each other.
"""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, NamedTuple

from mcap.opcode import Opcode

from drivers.errors import LogError
from drivers.regular_file import open_regular
from hil.record.mcap_file import MAGIC
from hil.record.mcap_read import HEAD, OPCODES, Record, decompress, longest

_SHORTEST = {
    Opcode.SCHEMA: 14, Opcode.CHANNEL: 16, Opcode.MESSAGE: 22, Opcode.CHUNK: 40, Opcode.MESSAGE_INDEX: 6,
    Opcode.ATTACHMENT: 36, Opcode.METADATA: 8, Opcode.DATA_END: 4, Opcode.FOOTER: 20, Opcode.STATISTICS: 46,
}  # fmt: skip
"""Least bytes of a kind of record."""
_BEGIN = re.compile(rb"(?=[\x01-\x0f][\s\S]{4}\x00{4})")
"""A known opcode and a length below 4 GiB."""
_WINDOW = 1 << 20


class Lost(NamedTuple):
    """Bytes of a file that are no record."""

    start: int
    stop: int


def surviving(path: Path, *, index: bool = False) -> Iterator[Record | Lost]:
    """Yield the records of the data section in their order, and what lies between them.

    index: those of the index behind it, too. A record whose end is cut off comes last and is not complete.

    Raises OSError.
    """
    with open_regular(path) as file:
        size = file.seek(0, 2)
        at = len(MAGIC)
        while at + HEAD.size <= size:
            opcode, length = _head(file, at)
            end = at + HEAD.size + length
            if opcode == Opcode.FOOTER and length == 20:
                return
            if opcode == Opcode.DATA_END and length == 4:
                if not index:
                    return
                at = end
                continue
            if _plausible(opcode, length):
                record, further = _settled(file, at, opcode, length, size)
                if record is not None:
                    yield record
                    at = end
                    if record.complete:
                        continue
                    return
            else:
                further = _next(file, at + 1, size, size)
            stop = size if further is None else further
            yield Lost(at, stop)
            at = stop
        if at < size:
            yield Lost(at, size)


def _settled(
    file: BinaryIO, at: int, opcode: int, length: int, size: int
) -> tuple[Record | None, int | None]:
    """Return the record at a place; where its length is damaged, None and where the next record begins."""
    end = at + HEAD.size + length
    if end <= size:
        record = Record(opcode, at, _read(file, at + HEAD.size, length), complete=True)
        if _sound(file, end, size) or _verified(record):
            return record, None
        further = _next(file, at + 1, end, size)
        return (record, None) if further is None else (None, further)
    further = _next(file, at + 1, size, size)
    if further is not None:
        return None, further
    return Record(opcode, at, _read(file, at + HEAD.size, size - at - HEAD.size), complete=False), None


def _head(file: BinaryIO, at: int) -> tuple[int, int]:
    opcode, length = HEAD.unpack(_read(file, at, HEAD.size))
    return int(opcode), int(length)


def _read(file: BinaryIO, at: int, length: int) -> bytes:
    file.seek(at)
    return file.read(length)


def _plausible(opcode: int, length: int) -> bool:
    return opcode in OPCODES and _SHORTEST.get(Opcode(opcode), 0) <= length <= longest(opcode)


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
        if record.opcode == Opcode.CHUNK:
            decompress(found)
            fields = _SHORTEST[Opcode.CHUNK] + len(found.compression) + len(found.data)
            return bool(found.uncompressed_crc) and len(record.content) == fields
        return record.opcode == Opcode.ATTACHMENT and record.content[-4:] != bytes(4)
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
