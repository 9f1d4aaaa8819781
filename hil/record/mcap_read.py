"""Reads MCAP records in the order of the file, whoever wrote it and however it ends.

Unlike the `mcap` library's readers it goes through a file that has no summary or is cut, and gives a chunk's
messages as positions in one buffer instead of one object each.
"""

import struct
import zlib
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

import lz4.frame  # type: ignore[import-untyped]
import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, Metadata, Schema

from drivers.arrays import Ints
from drivers.errors import LogError
from hil.record.mcap_file import MAGIC

_HEAD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<BQHIQ")
_CHUNK = struct.Struct("<QQQII")
_PIECE = 1 << 20
_READERS: dict[int, Any] = {
    Opcode.ATTACHMENT: Attachment,
    Opcode.CHANNEL: Channel,
    Opcode.CHUNK: Chunk,
    Opcode.METADATA: Metadata,
    Opcode.SCHEMA: Schema,
}
OPCODES = frozenset(int(code) for code in Opcode)
MAX_CHUNK = 1 << 28
"""Bytes of a chunk when it is unpacked: nothing larger is taken from a log."""


class Record(NamedTuple):
    """One record: `complete` is False when the file ends inside it."""

    opcode: int
    offset: int
    content: bytes
    complete: bool

    @property
    def whole(self) -> bytes:
        """The record as it stands in the file."""
        return _HEAD.pack(self.opcode, len(self.content)) + self.content

    def parse(self) -> Any:
        """Return the record as an object of mcap.records, None for kinds that are not needed."""
        reader = _READERS.get(self.opcode)
        return reader.read(ReadDataStream(BytesIO(self.content))) if reader else None


class MessageTable(NamedTuple):
    """Where the messages of a buffer are, each (n,)."""

    channel: Ints
    log_time: Ints
    offset: Ints
    length: Ints
    """Of the whole record; the data begin 31 bytes after `offset`."""


def records(path: Path, skip: frozenset[int] = frozenset()) -> Iterator[Record]:
    """Yield the records of the data section, up to DataEnd or to where the file stops making sense.

    Records of the kinds in `skip` are passed over unread.
    """
    size = path.stat().st_size
    with path.open("rb") as file:
        if file.read(len(MAGIC)) != MAGIC:
            return
        offset = len(MAGIC)
        while offset + _HEAD.size <= size:
            opcode, length = _HEAD.unpack(file.read(_HEAD.size))
            if opcode == Opcode.DATA_END or opcode not in OPCODES:
                return
            if opcode in skip:
                offset = file.seek(length, 1)
                continue
            content = file.read(min(length, size - offset - _HEAD.size))
            yield Record(opcode, offset, content, len(content) == length)
            if len(content) < length:
                return
            offset += _HEAD.size + length


def decompress(chunk: Chunk) -> bytes:
    """Return the records in a chunk.

    Raises
    ------
    LogError
        The chunk is damaged, too large, or compressed in a way that MCAP does not define.

    """
    data, size = bytes(chunk.data), chunk.uncompressed_size
    if size > MAX_CHUNK:
        raise LogError(f"a chunk of {size} bytes: at most {MAX_CHUNK} are unpacked")
    try:
        if chunk.compression == "zstd":
            data = zstandard.ZstdDecompressor().stream_reader(data).read(size + 1)
        elif chunk.compression == "lz4":
            data = lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=size + 1)
        elif chunk.compression:
            raise LogError(f"a chunk is compressed by {chunk.compression!r}: allowed are zstd, lz4 and none")
    except (zstandard.ZstdError, RuntimeError) as error:
        raise LogError(f"a chunk cannot be decompressed: {error}") from error
    if len(data) != chunk.uncompressed_size or (
        chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc
    ):
        raise LogError("a chunk is damaged: its checksum differs")
    return data


def decompress_part(content: bytes) -> bytes:
    """Return as many of the records as there are in the beginning of a zstd or uncompressed chunk."""
    if len(content) < _CHUNK.size:
        return b""
    name_length = _CHUNK.unpack_from(content)[4]
    start = _CHUNK.size + name_length + 8
    compression, data = content[_CHUNK.size : _CHUNK.size + name_length], content[start:]
    if compression == b"":
        return data
    if compression != b"zstd" or not data:
        return b""
    reader = zstandard.ZstdDecompressor().stream_reader(data)
    parts: list[bytes] = []
    try:
        while len(parts) < MAX_CHUNK // _PIECE and (part := reader.read(_PIECE)):
            parts.append(part)
    except zstandard.ZstdError:
        return b""
    return b"".join(parts)


def split(data: bytes) -> tuple[MessageTable, list[Record]]:
    """Find the complete records in a buffer: messages as a table, others as they are."""
    channel, log_time, offset, length = [], [], [], []
    others = []
    position, size = 0, len(data)
    unpack, head = _MESSAGE.unpack_from, _MESSAGE.size
    while position + head <= size:
        opcode, count, channel_id, _, time_ns = unpack(data, position)
        end = position + 9 + count
        if end > size:
            break
        if opcode == 5:
            channel.append(channel_id)
            log_time.append(time_ns)
            offset.append(position)
            length.append(end - position)
        else:
            others.append(Record(opcode, position, data[position + 9 : end], complete=True))
        position = end
    table = MessageTable(*(np.array(column, np.int64) for column in (channel, log_time, offset, length)))
    return table, others
