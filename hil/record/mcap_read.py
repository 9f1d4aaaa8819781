"""MCAP records of an untrusted file, parsed with the record classes of the `mcap` library.

The library's own readers trust the sizes in a file, need its index, and build an object for each message.
This module limits what is read and unpacked, reads a truncated file up to its end, and keeps the messages of
a chunk as offsets into one buffer.
"""

import os
import struct
import zlib
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import lz4.frame  # type: ignore[import-untyped]
import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, Metadata, Statistics
from numpy.typing import NDArray

from drivers.arrays import Ints
from drivers.errors import LogError
from drivers.files import open_regular
from hil.record.layout import RECORD_HEADER, scan, words_of
from hil.record.mcap_file import MAGIC

HEAD = struct.Struct("<BQ")
_KINDS: dict[int, Any] = {
    Opcode.ATTACHMENT: Attachment,
    Opcode.CHANNEL: Channel,
    Opcode.CHUNK: Chunk,
    Opcode.METADATA: Metadata,
    Opcode.STATISTICS: Statistics,
}
_BROKEN = (McapError, UnicodeDecodeError, OverflowError, struct.error)
"""Errors of the library for a field that exceeds its record, or is not text."""
OPCODES = frozenset(int(code) for code in Opcode)
NOTHING = 0
"""Opcode for bytes that are not a record."""
MAX_CHUNK = 1 << 24
"""Largest chunk, bytes, compressed or not."""
MAX_RECORD = 1 << 26
"""Largest record other than a chunk, bytes."""
FREE_BYTES, MAX_RATIO = 1 << 28, 40
"""Limit of a log's decompressed size: fixed part, bytes, and part for each byte of the file (2 to 6 are
usual)."""
MESSAGE_BYTES = 256
"""Bytes of the allowance that each message costs in addition to its content."""


class DamageError(LogError):
    """A log has damaged bytes; the message states where."""


class Record(NamedTuple):
    """One MCAP record of a file; `content` is shorter than `length` in a truncated file."""

    opcode: int
    offset: int
    """Position in the file; for a record in a chunk, the position of the chunk."""
    length: int
    """Length of the content according to the record's header, bytes."""
    content: bytes

    @property
    def complete(self) -> bool:
        """True if the record is valid and its whole content was read."""
        return self.opcode != NOTHING and len(self.content) == self.length

    @property
    def end(self) -> int:
        """Byte position in the file at which the record ends according to its header."""
        return self.offset + HEAD.size + self.length

    @property
    def whole(self) -> bytes:
        """Bytes of the record: its header and the content that was read."""
        return HEAD.pack(self.opcode, self.length) + self.content

    def damaged(self, what: str) -> DamageError:
        """DamageError that states the byte position of this record and the text `what`."""
        return DamageError(f"damaged at byte {self.offset}: {what}")

    def parse(self) -> Any:
        """Parse the record into an object of mcap.records; None for kinds that are not needed.

        Raises LogError: a field exceeds the record or is not text, or the checksum of an attachment differs.
        """
        kind, stream = _KINDS.get(self.opcode), ReadDataStream(BytesIO(self.content))
        try:
            found = kind and kind.read(stream)
        except _BROKEN:
            what = f"a record of kind {self.opcode} with a field that exceeds the record or is not text"
            raise self.damaged(what) from None
        if isinstance(found, Attachment):
            end = stream.count - 4
            crc = int.from_bytes(self.content[end : end + 4], "little")
            if crc and zlib.crc32(self.content[:end]) != crc:  # 0: its writer has made none
                raise self.damaged(f"the checksum of attachment {found.name!r} differs")
        return found


class MessageTable(NamedTuple):
    """Table of the messages in a chunk, for access without decoding; each array is (n,)."""

    channel: Ints
    sequence: Ints
    """Low 32 bits of the tick."""
    log_time: Ints
    offset: Ints
    length: Ints
    """Length of the whole record, bytes; its data begin 31 bytes after `offset`."""

    def before(self, begun: NDArray[np.intp]) -> "MessageTable":
        """Messages of the complete ticks of a truncated chunk, without its last tick, which may lack frames.

        begun: indices of the rows; each row starts a tick.
        """
        return MessageTable(*(column[: begun[-1] if len(begun) else 0] for column in self))


class Allowance:
    """Limit on the decompressed size of a log, as a small file could fill the memory. State: bytes left."""

    def __init__(self, file_bytes: int) -> None:
        self._most = self._left = FREE_BYTES + MAX_RATIO * file_bytes

    def spend(self, size: int) -> None:
        """Deduct `size` bytes before they are decompressed. Raises LogError if fewer bytes are left."""
        self._left -= size
        if self._left < 0:
            raise LogError(f"it unpacks to more than {self._most} bytes, the limit for a log of its size")


def record_at(file: BinaryIO, at: int, skip: frozenset[int] = frozenset()) -> Record:
    """Record at a position of a file, read up to the allowed size; without content for the kinds in `skip`.

    Bytes that are not a record have the opcode NOTHING.
    """
    file.seek(at)
    head = file.read(HEAD.size)
    opcode, length = HEAD.unpack(head) if len(head) == HEAD.size else (NOTHING, 0)
    if opcode not in OPCODES:
        return Record(NOTHING, at, 0, b"")
    most = MAX_CHUNK + 1024 if opcode == Opcode.CHUNK else MAX_RECORD
    return Record(opcode, at, length, b"" if opcode in skip else file.read(min(length, most)))


def records(path: Path, skip: frozenset[int] = frozenset(), *, cut: bool = False) -> Iterator[Record]:
    """Yield the records of the data section; for a truncated file also its incomplete last record.

    Records of the kinds in `skip`, and attachments larger than any of ours, are passed over.

    Raises LogError: invalid or too large record in a file that is not truncated; or the checksum of the data
    section differs (compared only if nothing was passed over); OSError: unreadable file.
    """
    with open_regular(path) as file:
        at, size = len(MAGIC), file.seek(0, os.SEEK_END)
        crc: int | None = zlib.crc32(MAGIC)
        while True:
            record = record_at(file, at, skip)
            at = record.end
            large = record.opcode == Opcode.ATTACHMENT and record.length > MAX_RECORD
            if at <= size and (large or record.opcode in skip):
                crc = None
            elif not record.complete:
                if not cut:
                    raise record.damaged("no valid record: it is too long, or ends after the end of the file")
                if record.opcode != NOTHING:
                    yield record
                return
            elif record.opcode == Opcode.DATA_END:
                if crc is not None and int.from_bytes(record.content, "little") not in (0, crc):
                    where = f"damaged before byte {record.offset}"
                    raise DamageError(f"{where}: the checksum of the data section differs")
                return  # 0: its writer has made no checksum
            else:
                yield record
                crc = None if crc is None else zlib.crc32(record.whole, crc)


def _unpacked(record: Record, allowance: Allowance) -> bytes:
    """Decompressed content of a chunk; of a truncated chunk only its readable beginning."""
    chunk = record.parse()
    size, data = chunk.uncompressed_size, bytes(chunk.data)
    if size > MAX_CHUNK:
        raise record.damaged(f"a chunk of {size} bytes, allowed: {MAX_CHUNK}")
    allowance.spend(size)
    try:
        if chunk.compression == "zstd":
            data = zstandard.ZstdDecompressor().stream_reader(data).read(size + 1)
        elif chunk.compression == "lz4":
            data = lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=size + 1)
        elif chunk.compression:
            raise record.damaged(f"a chunk of compression {chunk.compression!r}, allowed: zstd, lz4 and none")
    except (zstandard.ZstdError, RuntimeError, MemoryError) as error:
        raise record.damaged(f"a chunk cannot be decompressed: {error}") from error
    if record.complete and (len(data) != size or chunk.uncompressed_crc not in (0, zlib.crc32(data))):
        raise record.damaged("the checksum of a chunk differs")
    return data[:size]


def messages_in(record: Record, allowance: Allowance) -> tuple[bytes, MessageTable, list[Channel]]:
    """Decompressed bytes of a chunk, table of its messages, and the channels defined in the chunk.

    For an incomplete chunk: its complete messages, or none if it is damaged as well.

    Raises LogError: damaged chunk, or more bytes than the allowance.
    """
    try:
        data = _unpacked(record, allowance)
        return data, *_split(record, data, allowance)
    except LogError:
        if record.complete:
            raise
        return b"", MessageTable(*np.zeros((5, 0), np.int64)), []


def _split(record: Record, data: bytes, allowance: Allowance) -> tuple[MessageTable, list[Channel]]:
    """Table of the messages, and the channels, in the decompressed bytes of a chunk."""
    starts, end = scan(data)
    if end < len(data) and record.complete:
        raise record.damaged(f"the last {len(data) - end} bytes of a chunk are not a record")
    allowance.spend(MESSAGE_BYTES * len(starts))
    words = words_of(data)
    opcode, length = words[starts] & 0xFF, words[starts + 1] + HEAD.size
    channels = []
    for k in np.flatnonzero(opcode != Opcode.MESSAGE).tolist():
        if opcode[k] not in {Opcode.SCHEMA, Opcode.CHANNEL}:
            raise record.damaged("a record in a chunk that is not a message, schema or channel")
        content = data[starts[k] + HEAD.size : starts[k] + length[k]]
        channels.append(Record(int(opcode[k]), record.offset, len(content), content).parse())
    mine = opcode == Opcode.MESSAGE
    at = starts[mine]
    columns = words[at + 9] & 0xFFFF, words[at + 11] & 0xFFFFFFFF, words[at + 15], at, length[mine]
    messages = MessageTable(*columns)
    if (messages.log_time < 0).any() or (messages.length < RECORD_HEADER).any():
        raise record.damaged("a message of less than 22 bytes, or of a time after the year 2262")
    return messages, [each for each in channels if each is not None]
