"""From the bytes of one MCAP record to its fields, none of which may reach past its end.

A log comes from anywhere: each length in it is checked against what is there before anything is read or made
by it, and the checksum of an attachment is compared.
"""

import struct
import zlib
from collections.abc import Callable
from typing import Any

from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, DataEnd, Footer, Metadata, Schema, Statistics

from drivers.errors import LogError

_U16, _U32, _U64 = struct.Struct("<H"), struct.Struct("<I"), struct.Struct("<Q")


class _Fields:
    """Reads the fields of a record one after the other. State: where the next one begins."""

    def __init__(self, content: bytes) -> None:
        self._content = content
        self.at = 0

    def bytes(self, length: int) -> bytes:
        """Return the next `length` bytes."""
        end = self.at + length
        if end > len(self._content):
            raise LogError(
                f"a field of {length} bytes reaches past the end of its record, which has "
                f"{len(self._content) - self.at} left"
            )
        data = self._content[self.at : end]
        self.at = end
        return data

    def _number(self, kind: struct.Struct) -> int:
        (number,) = kind.unpack(self.bytes(kind.size))
        return int(number)

    def u16(self) -> int:
        return self._number(_U16)

    def u32(self) -> int:
        return self._number(_U32)

    def u64(self) -> int:
        return self._number(_U64)

    def text(self) -> str:
        data = self.bytes(self.u32())
        try:
            return data.decode()
        except UnicodeDecodeError as error:
            raise LogError(f"a text is not UTF-8: {error.reason} in its byte {error.start}") from None

    def _end_of_map(self) -> int:
        length = self.u32()
        end = self.at + length
        if end > len(self._content):
            raise LogError(f"a list of {length} bytes reaches past the end of its record")
        return end

    def texts(self) -> dict[str, str]:
        end, found = self._end_of_map(), {}
        while self.at < end:
            key = self.text()
            found[key] = self.text()
        return found

    def counts(self) -> dict[int, int]:
        end, found = self._end_of_map(), {}
        while self.at < end:
            key = self.u16()
            found[key] = self.u64()
        return found


def _attachment(f: _Fields, content: bytes) -> Attachment:
    log_time, create_time, name, media_type = f.u64(), f.u64(), f.text(), f.text()
    data = f.bytes(f.u64())
    end, crc = f.at, f.u32()
    if crc and zlib.crc32(content[:end]) != crc:  # 0: its writer has made none
        raise LogError(f"attachment {name!r} is damaged: its checksum differs")
    return Attachment(create_time=create_time, log_time=log_time, name=name, media_type=media_type, data=data)


def _channel(f: _Fields, content: bytes) -> Channel:
    del content
    number, schema, topic, encoding = f.u16(), f.u16(), f.text(), f.text()
    return Channel(id=number, schema_id=schema, topic=topic, message_encoding=encoding, metadata=f.texts())


def _chunk(f: _Fields, content: bytes) -> Chunk:
    del content
    start, end, size, crc, compression = f.u64(), f.u64(), f.u64(), f.u32(), f.text()
    return Chunk(
        compression=compression,
        data=f.bytes(f.u64()),
        message_end_time=end,
        message_start_time=start,
        uncompressed_crc=crc,
        uncompressed_size=size,
    )


def _schema(f: _Fields, content: bytes) -> Schema:
    del content
    number, name, encoding = f.u16(), f.text(), f.text()
    return Schema(id=number, name=name, encoding=encoding, data=f.bytes(f.u32()))


def _statistics(f: _Fields, content: bytes) -> Statistics:
    del content
    messages, schemas, channels = f.u64(), f.u16(), f.u32()
    attachments, metadata, chunks = f.u32(), f.u32(), f.u32()
    start, end = f.u64(), f.u64()
    return Statistics(
        attachment_count=attachments,
        channel_count=channels,
        channel_message_counts=f.counts(),
        chunk_count=chunks,
        message_count=messages,
        message_end_time=end,
        message_start_time=start,
        metadata_count=metadata,
        schema_count=schemas,
    )


_READERS: dict[int, Callable[[_Fields, bytes], Any]] = {
    Opcode.ATTACHMENT: _attachment,
    Opcode.CHANNEL: _channel,
    Opcode.CHUNK: _chunk,
    Opcode.DATA_END: lambda f, _: DataEnd(f.u32()),
    Opcode.FOOTER: lambda f, _: Footer(f.u64(), f.u64(), f.u32()),
    Opcode.METADATA: lambda f, _: Metadata(name=f.text(), metadata=f.texts()),
    Opcode.SCHEMA: _schema,
    Opcode.STATISTICS: _statistics,
}


def parse_record(opcode: int, content: bytes) -> Any:
    """Return a record as an object of mcap.records, None for kinds that are not needed.

    Raises
    ------
    LogError
        A field reaches past the end, a text is none, or the checksum of an attachment differs.

    """
    reader = _READERS.get(opcode)
    return None if reader is None else reader(_Fields(content), content)
