"""MCAP records by the `mcap` library's classes, each over its own bytes, whoever wrote the file.

The library's readers trust the sizes that a file states, need its index, and make an object of each message.
Here nothing larger than allowed is read or unpacked, a file that is cut is read as far as it goes, and the
messages of a chunk are places in one buffer.
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
from hil.record.layout import RECORD_HEADER
from hil.record.mcap_file import MAGIC
from hil.record.unpack import scan, words_of

HEAD = struct.Struct("<BQ")
_KINDS: dict[int, Any] = {
    Opcode.ATTACHMENT: Attachment,
    Opcode.CHANNEL: Channel,
    Opcode.CHUNK: Chunk,
    Opcode.METADATA: Metadata,
    Opcode.STATISTICS: Statistics,
}
_BROKEN = (McapError, UnicodeDecodeError, OverflowError, struct.error)
"""What the library raises of a field that reaches past the end of its record, or is no text."""
OPCODES = frozenset(int(code) for code in Opcode)
NOTHING = 0
"""Opcode of what is not a record."""
MAX_CHUNK = 1 << 24
"""Bytes of a chunk, packed or unpacked."""
MAX_RECORD = 1 << 26
"""Bytes of any other record."""
FREE_BYTES, MAX_RATIO = 1 << 28, 40
"""A log may unpack to so many bytes, and so many more for each byte of its file: 2 to 6 are usual."""
MESSAGE_BYTES = 256
"""What a message counts beyond its own bytes."""


class DamageError(LogError):
    """Bytes of a log are not as they were written."""


class Record(NamedTuple):
    """One record, as far as it was read."""

    opcode: int
    offset: int
    """Where in the file it begins; of one in a chunk, where the chunk does."""
    length: int
    """Bytes that its content has by its head."""
    content: bytes

    @property
    def complete(self) -> bool:
        """Whether all of it is there."""
        return self.opcode != NOTHING and len(self.content) == self.length

    @property
    def end(self) -> int:
        """Where it ends by its head."""
        return self.offset + HEAD.size + self.length

    @property
    def whole(self) -> bytes:
        """What is there of it, as it stands in the file."""
        return HEAD.pack(self.opcode, self.length) + self.content

    def damaged(self, what: str) -> DamageError:
        """Return the error for a damaged record."""
        return DamageError(f"damaged at byte {self.offset}: {what}")

    def parse(self) -> Any:
        """Return the record as an object of mcap.records, None for kinds that are not needed.

        Raises LogError: a field reaches past the end or is no text, or the checksum of an attachment differs.
        """
        kind, stream = _KINDS.get(self.opcode), ReadDataStream(BytesIO(self.content))
        try:
            found = kind and kind.read(stream)
        except _BROKEN:
            what = f"a record of kind {self.opcode} with a field that ends behind it or is no text"
            raise self.damaged(what) from None
        if isinstance(found, Attachment):
            end = stream.count - 4
            crc = int.from_bytes(self.content[end : end + 4], "little")
            if crc and zlib.crc32(self.content[:end]) != crc:  # 0: its writer has made none
                raise self.damaged(f"the checksum of attachment {found.name!r} differs")
        return found


class MessageTable(NamedTuple):
    """Where the messages of a buffer are, each (n,)."""

    channel: Ints
    sequence: Ints
    """The lower 32 bits of the tick."""
    log_time: Ints
    offset: Ints
    length: Ints
    """Of the whole record; the data begin 31 bytes after `offset`."""

    def before(self, begun: NDArray[np.intp]) -> "MessageTable":
        """Return the messages of whole ticks of a chunk that is cut: the last one begun may lack frames.

        begun : the places of the rows, with each of which a tick begins
        """
        return MessageTable(*(column[: begun[-1] if len(begun) else 0] for column in self))


class Allowance:
    """How much a log may still unpack to: a small file could fill memory and time. State: what is left."""

    def __init__(self, file_bytes: int) -> None:
        self._most = self._left = FREE_BYTES + MAX_RATIO * file_bytes

    def spend(self, size: int) -> None:
        """Take bytes before they are unpacked. Raises LogError where there are not so many left."""
        self._left -= size
        if self._left < 0:
            raise LogError(f"it unpacks to more than {self._most} bytes, which no log of its size does")


def record_at(file: BinaryIO, at: int, skip: frozenset[int] = frozenset()) -> Record:
    """Return the record at a place of a file, no more of it than is allowed; of the kinds in `skip` nothing.

    What is no record has the opcode NOTHING.
    """
    file.seek(at)
    head = file.read(HEAD.size)
    opcode, length = HEAD.unpack(head) if len(head) == HEAD.size else (NOTHING, 0)
    if opcode not in OPCODES:
        return Record(NOTHING, at, 0, b"")
    most = MAX_CHUNK + 1024 if opcode == Opcode.CHUNK else MAX_RECORD
    return Record(opcode, at, length, b"" if opcode in skip else file.read(min(length, most)))


def records(path: Path, skip: frozenset[int] = frozenset(), *, cut: bool = False) -> Iterator[Record]:
    """Yield the records of the data section; of a file that is cut, what is there of its last record, too.

    Records of the kinds in `skip` are passed over, and so are attachments that are larger than any of ours.

    Raises LogError: a file that is not cut stops making sense, or has a record larger than allowed; or the
    checksum of the data section differs, which is looked at where nothing was passed over; OSError: the file
    cannot be read.
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
                    raise record.damaged("no record, or one that is too long or ends behind the file")
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
    """Return what is in a chunk; of one that is cut, what is there of it."""
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
    """Return the bytes in a chunk, its messages, and the channels that stand between them.

    Of a chunk that is cut, those that are whole; none where it is damaged, too.

    Raises LogError: the chunk is damaged, or larger than the allowance.
    """
    try:
        data = _unpacked(record, allowance)
        return data, *_split(record, data, allowance)
    except LogError:
        if record.complete:
            raise
        return b"", MessageTable(*np.zeros((5, 0), np.int64)), []


def _split(record: Record, data: bytes, allowance: Allowance) -> tuple[MessageTable, list[Channel]]:
    """Find the whole records in a chunk's buffer."""
    starts, end = scan(data)
    if end < len(data) and record.complete:
        raise record.damaged(f"the last {len(data) - end} bytes of a chunk are no record")
    allowance.spend(MESSAGE_BYTES * len(starts))
    words = words_of(data)
    opcode, length = words[starts] & 0xFF, words[starts + 1] + HEAD.size
    channels = []
    for k in np.flatnonzero(opcode != Opcode.MESSAGE).tolist():
        if opcode[k] not in {Opcode.SCHEMA, Opcode.CHANNEL}:
            raise record.damaged("a record in a chunk that is no message, schema or channel")
        content = data[starts[k] + HEAD.size : starts[k] + length[k]]
        channels.append(Record(int(opcode[k]), record.offset, len(content), content).parse())
    mine = opcode == Opcode.MESSAGE
    at = starts[mine]
    columns = words[at + 9] & 0xFFFF, words[at + 11] & 0xFFFFFFFF, words[at + 15], at, length[mine]
    messages = MessageTable(*columns)
    if (messages.log_time < 0).any() or (messages.length < RECORD_HEADER).any():
        raise record.damaged("a message of less than 22 bytes, or of a time after the year 2262")
    return messages, [each for each in channels if each is not None]
