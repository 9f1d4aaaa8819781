"""Reads MCAP records in the order of the file, whoever wrote it and however it ends.

Unlike the `mcap` library's readers it goes through a file that has no summary or is cut, gives a chunk's
messages as positions in one buffer instead of one object each, and takes no size on trust.
"""

import os
import struct
import zlib
from collections.abc import Callable, Iterator
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import lz4.frame  # type: ignore[import-untyped]
import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, Metadata, Schema, Statistics
from numpy.typing import NDArray

from drivers.arrays import Ints
from drivers.errors import LogError
from drivers.files import open_regular
from hil.record.mcap_file import MAGIC
from hil.record.unpack import PLAIN, SHORTEST, words_of

HEAD = struct.Struct("<BQ")
_TAIL = HEAD.size + 20 + len(MAGIC)
_KINDS: dict[int, Any] = {
    Opcode.ATTACHMENT: Attachment,
    Opcode.CHANNEL: Channel,
    Opcode.CHUNK: Chunk,
    Opcode.METADATA: Metadata,
    Opcode.SCHEMA: Schema,
    Opcode.STATISTICS: Statistics,
}
_DESCRIPTIONS, _MOST_DESCRIPTIONS = frozenset({3, 4}), 1024
"""Schemas and channels may stand in a chunk beside the messages, and so many of them."""
OPCODES = frozenset(int(code) for code in Opcode)
MAX_CHUNK = 1 << 24
"""Bytes of a chunk, packed or unpacked: nothing larger is taken from a log."""
MAX_RECORD = 1 << 26
"""Bytes of any other record."""
MAX_SUMMARY = 1 << 28
"""Bytes of an index; one of a log of 1 TB stays below."""
FREE_BYTES, MAX_RATIO = 1 << 28, 40
"""A log may unpack to so many bytes, and so many more for each byte of its file: 2 to 6 are usual."""
FREE_MESSAGES, LEAST_BYTES = 50_000, 8
"""So many messages may be in it, and one more for so many bytes of its file: 50 to 250 are usual."""
NOTHING = 0
"""Opcode of what is not a record."""


class Record(NamedTuple):
    """One record: `complete` is False when the file ends inside it, or where no record is."""

    opcode: int
    offset: int
    content: bytes
    complete: bool

    @property
    def whole(self) -> bytes:
        """The record as it stands in the file."""
        return HEAD.pack(self.opcode, len(self.content)) + self.content

    def parse(self) -> Any:
        """Return the record as an object of mcap.records, None for kinds that are not needed.

        Raises
        ------
        LogError
            A field reaches past the end, a text is not UTF-8, or the checksum of an attachment differs.

        """
        kind, fields = _KINDS.get(self.opcode), _Fields(self.content)
        try:
            found = kind and kind.read(fields)
        except UnicodeDecodeError as error:
            raise LogError(f"a text is not UTF-8: {error.reason} in its byte {error.start}") from None
        if isinstance(found, Attachment):
            end = fields.count - 4
            crc = int.from_bytes(self.content[end : end + 4], "little")
            if crc and zlib.crc32(self.content[:end]) != crc:  # 0: its writer has made none
                raise LogError(f"attachment {found.name!r} is damaged: its checksum differs")
        return found


class _Fields(ReadDataStream):
    """The bytes of one record, past whose end no field may reach: `mcap` takes a shorter one as it is."""

    def __init__(self, content: bytes) -> None:
        super().__init__(BytesIO(content))
        self._size = len(content)

    def read(self, length: int) -> bytes:
        left = self._size - self.count
        if length > left:
            raise LogError(
                f"a field of {length} bytes reaches past the end of its record, which has {left} left"
            )
        return super().read(length)


class MessageTable(NamedTuple):
    """Where the messages of a buffer are, each (n,)."""

    channel: Ints
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
    """How much a log may still unpack to. State: the bytes and messages that are taken.

    A small file that unpacks without end would fill memory and time.
    """

    def __init__(self, file_bytes: int) -> None:
        self._file_bytes = file_bytes
        self._bytes = self._messages = 0

    def spend(self, size: int = 0, messages: int = 0) -> None:
        """Take bytes before they are unpacked, and messages that were found.

        Raises
        ------
        LogError
            There are not so many left.

        """
        self._bytes += size
        self._messages += messages
        has = f"the file has {self._file_bytes} bytes and"
        if self._bytes > (most := FREE_BYTES + MAX_RATIO * self._file_bytes):
            raise LogError(f"{has} unpacks to more than {most}, which no log of a run does")
        if self._messages > (most := FREE_MESSAGES + self._file_bytes // LEAST_BYTES):
            raise LogError(f"{has} more than {most} messages, which no log of a run has")


def longest(opcode: int) -> int:
    """Return how many bytes a record of a kind may have."""
    return MAX_CHUNK + 1024 if opcode == Opcode.CHUNK else MAX_RECORD


def records(path: Path, skip: frozenset[int] = frozenset()) -> Iterator[Record]:
    """Yield the records of the data section, up to DataEnd or to where the file stops making sense.

    Records of the kinds in `skip` are passed over unread. Where no record is, or the file ends without
    DataEnd, the last one has the opcode NOTHING.

    Raises
    ------
    LogError
        A record is larger than any is allowed to be, or the checksum of the whole data section differs; that
        is looked at where nothing is skipped.
    OSError
        The file cannot be read.

    """
    with open_regular(path) as file:
        size = file.seek(0, os.SEEK_END)
        file.seek(0)
        crc = zlib.crc32(file.read(len(MAGIC)))
        offset = len(MAGIC)
        while offset + HEAD.size <= size:
            head = file.read(HEAD.size)
            opcode, length = HEAD.unpack(head)
            end = offset + HEAD.size + length
            if opcode not in OPCODES:
                break
            if opcode == Opcode.DATA_END and end <= size:
                _check_end(file, offset, length, None if skip else crc)
                return
            if opcode in skip and end <= size:
                offset = file.seek(end)
                continue
            if end <= size and length > longest(opcode):
                raise LogError(
                    f"damaged at byte {offset}: a record of {length} bytes, allowed: {longest(opcode)}"
                )
            content = file.read(min(length, longest(opcode)))
            yield Record(opcode, offset, content, len(content) == length)
            if len(content) < length:
                return
            crc = zlib.crc32(content, zlib.crc32(head, crc))
            offset = end
        yield Record(NOTHING, offset, b"", complete=False)


def _check_end(file: BinaryIO, offset: int, length: int, crc: int | None) -> None:
    if length != 4:
        raise LogError(f"damaged at byte {offset}: the end of the data has {length} bytes, allowed: 4")
    wanted = int.from_bytes(file.read(4), "little")
    if crc is not None and wanted and wanted != crc:  # 0: its writer has made none
        raise LogError(f"damaged somewhere before byte {offset}: the checksum of the data section differs")


def read_summary(path: Path) -> tuple[Statistics, dict[int, str]]:
    """Return the statistics of a whole file, and the topics of its channels by number.

    Raises
    ------
    LogError
        There is no index, or it is damaged.
    OSError
        The file cannot be read.

    """
    with open_regular(path) as file:
        size = file.seek(0, os.SEEK_END)
        end = file.seek(max(size - _TAIL, 0))
        tail = file.read(_TAIL)
        if len(tail) < _TAIL or HEAD.unpack_from(tail) != (Opcode.FOOTER, 20):
            raise LogError(f"damaged at byte {end}: no footer")
        start, _, crc = struct.unpack_from("<QQI", tail, HEAD.size)
        if not start:
            raise LogError("no index at the end")
        if not len(MAGIC) <= start <= end or end - start > MAX_SUMMARY:
            raise LogError(f"damaged at byte {end}: an index from byte {start} to {end} of {size}")
        file.seek(start)
        data = file.read(end - start)
    if crc and zlib.crc32(tail[: HEAD.size + 16], zlib.crc32(data)) != crc:
        raise LogError(f"damaged between byte {start} and {end}: the checksum of the index differs")
    statistics, topics, at = None, {}, 0
    while at + HEAD.size <= len(data):
        opcode, length = HEAD.unpack_from(data, at)
        content = data[at + HEAD.size : at + HEAD.size + length]
        if len(content) < length:
            raise LogError(f"damaged at byte {start + at}: a record of the index reaches past its end")
        if opcode in {Opcode.STATISTICS, Opcode.CHANNEL}:
            try:
                found = Record(opcode, start + at, content, complete=True).parse()
            except LogError as error:
                raise LogError(f"damaged at byte {start + at}: {error}") from None
            if isinstance(found, Channel):
                topics[found.id] = found.topic
            else:
                statistics = found
        at += HEAD.size + length
    if statistics is None:
        raise LogError(f"damaged: the index at byte {start} has no statistics")
    return statistics, topics


def decompress(chunk: Chunk) -> bytes:
    """Return the records in a chunk.

    Raises
    ------
    LogError
        The chunk is damaged, too large, or compressed in a way that MCAP does not define.

    """
    size = chunk.uncompressed_size
    if size > MAX_CHUNK:
        raise LogError(f"a chunk of {size} bytes: at most {MAX_CHUNK} are unpacked")
    data = _unpacked(chunk, size + 1)
    if len(data) != size or (chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc):
        raise LogError("a chunk is damaged: its checksum differs")
    return data


def decompress_part(content: bytes) -> bytes:
    """Return as many of the records as there are in the beginning of a chunk."""
    try:
        return _unpacked(Chunk.read(ReadDataStream(BytesIO(content))), MAX_CHUNK)
    except (McapError, LogError, UnicodeDecodeError, OverflowError, struct.error):
        return b""


def _unpacked(chunk: Chunk, most: int) -> bytes:
    """Return the first bytes of what is in a chunk."""
    data = bytes(chunk.data)
    try:
        if chunk.compression == "zstd":
            data = zstandard.ZstdDecompressor().stream_reader(data).read(most)
        elif chunk.compression == "lz4":
            data = lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=most)
        elif chunk.compression:
            raise LogError(f"a chunk is compressed by {chunk.compression!r}: allowed are zstd, lz4 and none")
    except (zstandard.ZstdError, RuntimeError, MemoryError) as error:
        raise LogError(f"a chunk cannot be decompressed: {error}") from error
    return data[:most]


def messages_in(
    record: Record, allowance: Allowance, scan: Callable[..., tuple[int, int]] = PLAIN.scan
) -> tuple[bytes, MessageTable, list[Record]]:
    """Return what is in a chunk, or in the beginning of one that is cut: its bytes, and `split` of them.

    Raises
    ------
    LogError
        The chunk is damaged, or larger than the allowance.

    """
    chunk = record.parse() if record.complete else None
    if chunk is not None:
        allowance.spend(chunk.uncompressed_size)
    data = decompress_part(record.content) if chunk is None else decompress(chunk)
    table, others = split(data, part=chunk is None, scan=scan)
    allowance.spend(messages=len(table.channel))
    return data, table, others


def split(
    data: bytes, *, part: bool = False, scan: Callable[..., tuple[int, int]] = PLAIN.scan
) -> tuple[MessageTable, list[Record]]:
    """Find the complete records in a buffer: messages as a table, others as they are.

    part: the buffer may end within a record; scan: the function of `hil.record.unpack`.

    Raises
    ------
    LogError
        A message is shorter than any can be or has no time, or something is left over.

    """
    size, words = len(data), words_of(data)
    table = np.empty((4, size // (SHORTEST + 9)), np.int64)
    others: list[Record] = []
    position = messages = 0
    while True:
        position, messages = map(int, scan(words, size, position, table, messages))
        opcode, count = HEAD.unpack_from(data, position) if position + HEAD.size <= size else (0, size)
        end = position + HEAD.size + count
        if end > size:
            break
        if opcode == Opcode.MESSAGE:
            raise LogError(f"a message of {count} bytes, allowed: {SHORTEST} and more")
        if opcode not in _DESCRIPTIONS or len(others) >= _MOST_DESCRIPTIONS:
            raise LogError(f"a record of kind {opcode} after {len(others)} others: no chunk has that")
        others.append(Record(opcode, position, data[position + HEAD.size : end], complete=True))
        position = end
    if position < size and not part:
        raise LogError(f"{size - position} bytes of {size} are no record")
    channel, log_time, offset, length = table[:, :messages]
    if (log_time < 0).any():
        raise LogError("a message has a time after the year 2262")
    return MessageTable(channel, log_time, offset, length), others
