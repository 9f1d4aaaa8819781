"""Makes a valid log of one that was cut: power loss, full disk, recorder killed.

The original is read, never touched; the result is a new file. Complete chunks are copied as they are; of a
chunk that is cut, the ticks that are complete.
"""

import os
import struct
from pathlib import Path
from typing import NamedTuple

import numpy as np
from mcap.exceptions import McapError
from mcap.opcode import Opcode

from drivers.errors import LogError
from hil.record.environment import product_version
from hil.record.mcap_file import MAGIC, McapFile
from hil.record.mcap_read import MessageTable, Record, decompress, decompress_part, records, split
from hil.record.schema import IDENTITY, LIBRARY, SALVAGE, SUMMARY


class SalvageReport(NamedTuple):
    """What was recovered and what was lost."""

    path: Path
    out: Path
    ticks: int
    messages: int
    chunks: int
    """Complete chunks."""
    partial_messages: int
    """Messages recovered from a chunk that was cut."""
    bytes_read: int
    bytes_lost: int
    """Bytes of the original that gave nothing."""
    complete: bool
    """Nothing but the index at the end was missing."""
    remarks: tuple[str, ...]


class _Salvage:
    """One salvage at work. State: the new file, and what was found so far."""

    def __init__(self, out: Path) -> None:
        self.file = McapFile(out, f"{LIBRARY}/{product_version()}")
        self.topic = ""
        self.closed = False
        self.chunks = self.ticks = self.partial = 0
        self.used = len(MAGIC)
        self.remarks: list[str] = []
        self._topics: dict[int, str] = {}
        self._schemas: set[int] = set()
        self._loose: list[bytes] = []

    def add(self, record: Record) -> None:
        """Take over one record of the original."""
        if record.opcode == Opcode.MESSAGE and record.complete:
            self._loose.append(record.whole)
            if len(self._loose) >= 1024:
                self.flush()
        elif record.opcode == Opcode.CHUNK:
            self.flush()
            if not self._chunk(record):
                return
        elif not record.complete:
            self.remarks.append(f"the file ends inside a record at byte {record.offset}")
            return
        else:
            self._other(record)
        self.used = record.offset + 9 + len(record.content)

    def _other(self, record: Record) -> None:
        match record.opcode:
            case Opcode.SCHEMA:
                schema = record.parse()
                if schema.id not in self._schemas:
                    self._schemas.add(schema.id)
                    self.file.add_schema(schema)
            case Opcode.CHANNEL:
                channel = record.parse()
                if channel.id not in self._topics:
                    self._topics[channel.id] = channel.topic
                    self.file.add_channel(channel)
            case Opcode.METADATA:
                metadata = record.parse()
                self.file.add_metadata(metadata.name, metadata.metadata)
                self.closed |= metadata.name == SUMMARY
                if metadata.name == IDENTITY:
                    self.topic = metadata.metadata.get("topic", "")
            case Opcode.ATTACHMENT:
                file = record.parse()
                self.file.add_attachment(file.name, file.data, file.log_time, file.media_type)

    def _chunk(self, record: Record) -> bool:
        """Take over a chunk, or what is there of it; return whether all of it was there."""
        if record.complete:
            try:
                chunk = record.parse()
                table, others = split(decompress(chunk))
            except (LogError, McapError, struct.error, UnicodeDecodeError) as error:
                self.remarks.append(f"the chunk at byte {record.offset} is damaged and left out: {error}")
                return True
            for other in others:
                self._other(other)
            self.file.add_compressed(chunk, table.channel, table.log_time, table.offset)
            self.chunks += 1
            self._count(table)
            return True
        data = decompress_part(record.content)
        table, others = split(data)
        for other in others:
            self._other(other)
        # the last tick begun may have lost frames: replay needs whole ticks
        begun = np.flatnonzero(self._is_tick(table))
        whole = int(begun[-1]) if len(begun) else 0
        if whole:
            self._write(data, MessageTable(*(column[:whole] for column in table)))
        self.partial = whole
        self.remarks.append(
            f"the file ends inside the chunk at byte {record.offset}: {whole} messages of it recovered"
        )
        return False

    def flush(self) -> None:
        """Write messages that stood outside chunks."""
        if self._loose:
            data, self._loose = b"".join(self._loose), []
            self._write(data, split(data)[0])

    def _write(self, data: bytes, table: MessageTable) -> None:
        parts = [data[o : o + n] for o, n in zip(table.offset.tolist(), table.length.tolist(), strict=True)]
        offset = np.cumsum(table.length) - table.length
        self.file.add_chunk(b"".join(parts), table.channel, table.log_time, offset)
        self._count(table)

    def _is_tick(self, table: MessageTable) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
        return np.isin(table.channel, [i for i, topic in self._topics.items() if topic == self.topic])

    def _count(self, table: MessageTable) -> None:
        self.ticks += int(np.count_nonzero(self._is_tick(table)))


def salvage(path: str | os.PathLike[str], out: str | os.PathLike[str]) -> SalvageReport:
    """Write to `out` a valid log with all that is readable in `path`.

    Raises
    ------
    LogError
        `path` is missing or no log of ours, cut before its first record; or `out` exists.

    """
    source, target = Path(path), Path(out)
    try:
        size = source.stat().st_size
        with source.open("rb") as file:
            head = file.read(len(MAGIC))
    except OSError as error:
        raise LogError(f"{source}: cannot be read: {error.strerror}") from error
    if head != MAGIC:
        raise LogError(f"{source}: not an MCAP file: nothing to salvage")
    if not any(
        r.complete and r.opcode == Opcode.METADATA and r.parse().name == IDENTITY for r in records(source)
    ):
        raise LogError(f"{source}: no log of this product, or cut within its first bytes: nothing to salvage")
    try:
        work = _Salvage(target)
    except FileExistsError:
        raise LogError(f"{target}: exists and is never overwritten: choose another name") from None
    except OSError as error:
        raise LogError(f"{target}: cannot be written: {error.strerror}") from error
    for record in records(source):
        work.add(record)
    work.flush()
    return _close(work, source, target, size)


def _close(work: _Salvage, source: Path, target: Path, size: int) -> SalvageReport:
    with source.open("rb") as file:
        file.seek(work.used)
        at_end = file.read(1) == bytes([Opcode.DATA_END])
    lost = 0 if at_end else size - work.used
    if lost and not work.remarks:
        work.remarks.append(f"from byte {work.used} on there are no records")
    damaged = any("damaged" in remark for remark in work.remarks)
    complete = work.closed and not lost and not damaged
    report = SalvageReport(
        path=source,
        out=target,
        ticks=work.ticks,
        messages=work.file.messages,
        chunks=work.chunks,
        partial_messages=work.partial,
        bytes_read=size,
        bytes_lost=lost,
        complete=complete,
        remarks=tuple(work.remarks),
    )
    work.file.add_metadata(
        SALVAGE,
        {
            "original": source.name,
            "original_bytes": str(size),
            "bytes_lost": str(lost),
            "remarks": "; ".join(work.remarks),
        },
    )
    if not work.closed:
        work.file.add_metadata(SUMMARY, {"closed": "salvaged", "ticks": str(work.ticks)})
    work.file.finish()
    return report
