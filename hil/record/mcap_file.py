"""Writes an MCAP file chunk by chunk from encoded messages.

The writer of the `mcap` library makes one Python call per message and per index entry (about 5 µs each). Here
a chunk is one buffer, and its message index is one array. `mcap.records` writes all records other than
Message and MessageIndex.
"""

import contextlib
import os
import struct
import zlib
from collections import deque
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import zstandard
from mcap import records as mcap
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode

from drivers.arrays import Ints
from drivers.files import BINARY, open_regular

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

MAGIC = b"\x89MCAP0\r\n"
CHUNK_SIZE = 256 * 1024
_INDEX_ENTRY = np.dtype([("log_time", "<u8"), ("offset", "<u8")])
_SUMMARY = (
    mcap.Schema,
    mcap.Channel,
    mcap.Statistics,
    mcap.ChunkIndex,
    mcap.AttachmentIndex,
    mcap.MetadataIndex,
)
"""Kinds of records in the summary, in their order."""
_MOST_TAKEN_BACK = 256
"""Most chunks that are removed to make room for the end of the file on a full disk."""
_Place = tuple[int, int, tuple[int, int] | None, dict[int, int], dict[type, int]]
"""State to which the file can return: position, CRC, time span, messages by channel, records by kind."""


def record_bytes(record: mcap.McapRecord) -> bytes:
    """Bytes of one MCAP record: opcode, length and content."""
    builder = RecordBuilder()
    record.write(builder)
    data: bytes = builder.end()  # type: ignore[no-untyped-call]
    return data


def being_written(path: Path) -> bool:
    """True while a process writes a file; False without access or lock, and on Windows."""
    if fcntl is None:
        return False
    try:
        with open_regular(path) as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        return False
    return False


class McapFile:
    """An MCAP file being written. State: the content of the summary at its end.

    The file is locked while it is written, so `being_written` can tell it from a truncated file.

    Raises FileExistsError if the file exists: no file is ever overwritten.
    """

    def __init__(self, path: Path, library: str) -> None:
        self.path = path
        self._fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | BINARY, 0o666)
        if fcntl is not None:
            with contextlib.suppress(OSError):  # a file system without locks
                fcntl.flock(self._fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        self.position = 0
        self._crc = 0
        self._summary: dict[type, list[bytes]] = {kind: [] for kind in _SUMMARY}
        self._counts: dict[int, int] = {}
        self._span: tuple[int, int] | None = None
        self._compressor = zstandard.ZstdCompressor(level=1)
        self._places: deque[_Place] = deque(maxlen=_MOST_TAKEN_BACK)
        """State of the file before each of the last chunks."""
        try:
            self._write(MAGIC + record_bytes(mcap.Header("", library)))
        except OSError:
            self.discard()
            raise

    def add(self, record: mcap.Schema | mcap.Channel) -> None:
        """Write a schema or channel record, also listed in the summary."""
        self._write(self._summarise(record))

    def add_metadata(self, name: str, data: Mapping[str, object]) -> None:
        """Write a metadata record `name`, with the values of `data` as text."""
        texts = {key: str(value) for key, value in data.items()}
        record = record_bytes(mcap.Metadata(name=name, metadata=texts))
        self._summarise(mcap.MetadataIndex(self.position, len(record), name))
        self._write(record)

    def add_attachment(self, name: str, data: bytes, time_ns: int, media_type: str) -> None:
        """Write an attachment: content `data` with a name, a time in ns of UTC and a media type."""
        record = record_bytes(mcap.Attachment(time_ns, time_ns, name, media_type, data))
        place = self.position, len(record)
        self._summarise(mcap.AttachmentIndex(*place, time_ns, time_ns, len(data), name, media_type))
        self._write(record)

    def add_chunk(self, data: bytes | memoryview, channel: Ints, log_time: Ints, offset: Ints) -> None:
        """Compress and write n > 0 Message records; the arrays (n,) describe those in `data`, in order."""
        chunk = mcap.Chunk(
            compression="zstd",
            data=self._compressor.compress(data),
            message_start_time=int(log_time.min()),
            message_end_time=int(log_time.max()),
            uncompressed_crc=zlib.crc32(data),
            uncompressed_size=len(data),
        )
        kinds = {kind: len(records) for kind, records in self._summary.items()}
        self._places.append((self.position, self._crc, self._span, dict(self._counts), kinds))
        record = record_bytes(chunk)
        index_start = self.position + len(record)
        parts = [record]
        offsets: dict[int, int] = {}
        position = index_start
        ids = channel.astype(np.uint16)
        order, counts = np.argsort(ids, kind="stable"), np.bincount(ids)
        entries = np.empty(len(ids), _INDEX_ENTRY)
        entries["log_time"], entries["offset"] = log_time[order], offset[order]
        last = 0
        for channel_id in np.flatnonzero(counts).tolist():
            first, last = last, last + int(counts[channel_id])
            body = entries[first:last].tobytes()
            parts.append(
                struct.pack("<BQHI", Opcode.MESSAGE_INDEX, 6 + len(body), channel_id, len(body)) + body
            )
            offsets[channel_id] = position
            position += len(parts[-1])
            self._counts[channel_id] = self.messages_of(channel_id) + last - first
        index = mcap.ChunkIndex(
            message_start_time=chunk.message_start_time,
            message_end_time=chunk.message_end_time,
            chunk_start_offset=self.position,
            chunk_length=len(record),
            message_index_offsets=offsets,
            message_index_length=position - index_start,
            compression=chunk.compression,
            compressed_size=len(chunk.data),
            uncompressed_size=chunk.uncompressed_size,
        )
        self._summarise(index)
        start, stop = self._span or (chunk.message_start_time, chunk.message_end_time)
        self._span = min(start, chunk.message_start_time), max(stop, chunk.message_end_time)
        self._write(b"".join(parts))

    def sync(self) -> None:
        """Flush the written data to the disk."""
        getattr(os, "fdatasync", os.fsync)(self._fd)

    @property
    def messages(self) -> int:
        """Number of messages of all channels written so far."""
        return sum(self._counts.values())

    def messages_of(self, channel: int) -> int:
        """Number of messages of one channel written so far."""
        return self._counts.get(channel, 0)

    def finish(self) -> None:
        """Write summary and footer, flush everything to the disk, and close the file."""
        self._write(record_bytes(mcap.DataEnd(self._crc)))
        self._summarise(self._statistics())
        summary_start, crc, groups = self.position, 0, b""
        for records in self._summary.values():
            if records:
                data = b"".join(records)
                groups += record_bytes(mcap.SummaryOffset(data[0], self.position, len(data)))
                crc = zlib.crc32(data, crc)
                self._write(data)
        offset_start = self.position
        head = record_bytes(mcap.Footer(summary_start, offset_start, 0))[:-4]
        footer = mcap.Footer(summary_start, offset_start, zlib.crc32(head, zlib.crc32(groups, crc)))
        self._write(groups + record_bytes(footer) + MAGIC)
        os.fsync(self._fd)
        self.close()

    def finish_within(self, name: str, metadata: Callable[[], Mapping[str, object]]) -> None:
        """Finish on a full disk: remove at least one of the last chunks to make room for the end.

        `metadata` is called again after each removed chunk. Without any chunk nothing is done. Raises OSError
        if the removed chunks do not make enough room.
        """
        while self._places:
            self._take_back(self._places.pop())
            try:
                self.add_metadata(name, metadata())
                self.finish()
            except OSError:
                if not self._places:
                    raise
            else:
                return

    def _take_back(self, place: _Place) -> None:
        position, crc, span, counts, kinds = place
        os.ftruncate(self._fd, position)
        os.lseek(self._fd, position, os.SEEK_SET)
        self.position, self._crc, self._span, self._counts = position, crc, span, counts
        for kind, records in self._summary.items():
            del records[kinds[kind] :]

    def close(self) -> None:
        """Close the file without a summary; further calls do nothing."""
        if self._fd >= 0:
            os.close(self._fd)
        self._fd = -1

    def discard(self) -> None:
        """Close the file and delete it."""
        self.close()
        self.path.unlink()

    def _statistics(self) -> mcap.Statistics:
        counts = {kind: len(records) for kind, records in self._summary.items()}
        start, stop = self._span or (0, 0)
        return mcap.Statistics(
            attachment_count=counts[mcap.AttachmentIndex],
            channel_count=counts[mcap.Channel],
            channel_message_counts=dict(self._counts),
            chunk_count=counts[mcap.ChunkIndex],
            message_count=self.messages,
            message_end_time=stop,
            message_start_time=start,
            metadata_count=counts[mcap.MetadataIndex],
            schema_count=counts[mcap.Schema],
        )

    def _summarise(self, record: mcap.McapRecord) -> bytes:
        """Add a record to the summary section; return the bytes of the record."""
        data = record_bytes(record)
        self._summary[type(record)].append(data)
        return data

    def _write(self, data: bytes) -> None:
        view = memoryview(data)
        while view:
            view = view[os.write(self._fd, view) :]
        self._crc = zlib.crc32(data, self._crc)
        self.position += len(data)
