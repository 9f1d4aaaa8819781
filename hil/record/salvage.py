"""Makes a valid log of one that was cut or damaged: power loss, full disk, recorder killed, bits turned over.

The original is read, never touched; the result is a new file, which gets its name when it is whole. Complete
chunks are copied as they are; of a chunk that is cut, the ticks that are complete. Schemas and channels stand
twice in a log: a damaged one is taken from the other place.
"""

import contextlib
import os
from pathlib import Path
from typing import NamedTuple

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Channel

from drivers.errors import LogError
from drivers.regular_file import open_regular
from hil.record.descriptions import Descriptions
from hil.record.environment import product_version
from hil.record.mcap_file import MAGIC, McapFile
from hil.record.mcap_read import (
    MAX_CHUNK,
    Allowance,
    MessageTable,
    Record,
    decompress,
    decompress_part,
    records,
    split,
)
from hil.record.schema import CLEAN, IDENTITY, LIBRARY, SALVAGE, SUMMARY
from hil.record.surviving import Lost, surviving

_MOST_LOOSE = 1024
"""Messages of a chunk that is made of those that stood outside chunks."""
_REMARKS = 20
"""Written into the log and reported; of more damage the number is."""


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
    ticks_lost: int = 0
    """Ticks of damaged chunks, as far as the index behind them counts them."""


class _Salvage:
    """One salvage at work. State: the new file, and what was found so far."""

    def __init__(self, out: Path, source: Path, size: int, descriptions: Descriptions) -> None:
        self.file = McapFile(out, f"{LIBRARY}/{product_version()}")
        self.end: dict[str, str] | None = None
        """What the run has said of its end."""
        self.chunks = self.ticks = self.partial = self.lost = self.ticks_lost = 0
        self.remarks: list[str] = list(descriptions.remarks)
        self._source = source
        self._allowance = Allowance(size)
        self._known = descriptions
        self._loose: list[bytes] = []
        self._loose_bytes = 0
        self._damaged = False
        """Whether the index that comes next is of a chunk that is left out."""

    def work(self) -> None:
        """Take over what survives of the original."""
        self.file.add_metadata(IDENTITY, self._known.identity)
        for schema in self._known.schemas.values():
            self.file.add_schema(schema)
        for channel in self._known.channels.values():
            self.file.add_channel(channel)
        for record in surviving(self._source):
            if isinstance(record, Lost):
                self.lost += record.stop - record.start
                self.remarks.append(f"bytes {record.start} to {record.stop} are damaged and left out")
            else:
                self._add(record)
        self._flush()
        if not self.lost and not self.remarks:
            self._compare()

    def _compare(self) -> None:
        """Say where the checksum of what is whole by its form tells that a bit has turned over.

        Metadata and the names of schemas and channels have no checksum of their own.
        """
        try:
            for _ in records(self._source):
                pass
        except LogError as error:
            self.remarks.append(f"{error}: what was taken over may hold the damage")

    def _add(self, record: Record) -> None:
        size = 9 + len(record.content)
        if record.opcode != Opcode.MESSAGE_INDEX:
            self._damaged = False
        try:
            if not record.complete and record.opcode != Opcode.CHUNK:
                self.remarks.append(f"the file ends inside a record at byte {record.offset}")
                self.lost += size
            elif record.opcode == Opcode.MESSAGE:
                self._message(record)
            elif record.opcode == Opcode.CHUNK:
                self._flush()
                if record.complete:
                    self._chunk(record)
                else:
                    self._part(record)
                    self.lost += size
            elif record.opcode == Opcode.MESSAGE_INDEX:
                self._index(record)
            else:
                self._other(record)
        except LogError as error:
            self._damaged = record.opcode == Opcode.CHUNK
            self.lost += size
            what = "the chunk" if self._damaged else "the record"
            self.remarks.append(f"{what} at byte {record.offset} is damaged and left out: {error}")

    def _message(self, record: Record) -> None:
        whole = record.whole
        split(whole)
        if len(whole) > MAX_CHUNK:
            raise LogError(f"a message of {len(whole)} bytes: at most {MAX_CHUNK} fit into a chunk")
        if len(self._loose) >= _MOST_LOOSE or self._loose_bytes + len(whole) > MAX_CHUNK:
            self._flush()
        self._loose.append(whole)
        self._loose_bytes += len(whole)

    def _other(self, record: Record) -> None:
        if record.opcode == Opcode.METADATA:
            metadata = record.parse()
            if metadata.name == SUMMARY:
                self.end = dict(metadata.metadata)
            elif metadata.name != IDENTITY:
                self.file.add_metadata(metadata.name, metadata.metadata)
        elif record.opcode == Opcode.ATTACHMENT:
            file = record.parse()
            self.file.add_attachment(file.name, file.data, file.log_time, file.media_type)

    def _chunk(self, record: Record) -> None:
        chunk = record.parse()
        self._allowance.spend(chunk.uncompressed_size)
        table, others = split(decompress(chunk))
        self._allowance.count(len(table.channel))
        self._describe(others)
        self._name(table)
        self.file.add_compressed(chunk, table.channel, table.log_time, table.offset)
        self.chunks += 1
        self._count(table)

    def _part(self, record: Record) -> None:
        """Take over the ticks of a chunk that is cut."""
        data = decompress_part(record.content)
        table, others = split(data, part=True)
        self._describe(others)
        # the last tick begun may have lost frames: replay needs whole ticks
        begun = np.flatnonzero(self._is_tick(table))
        whole = int(begun[-1]) if len(begun) else 0
        if whole:
            self._write(data, table.between(0, whole))
        self.partial = whole
        self.remarks.append(
            f"the file ends inside the chunk at byte {record.offset}: {whole} messages of it recovered"
        )

    def _index(self, record: Record) -> None:
        """Count the ticks of a chunk that is left out."""
        if self._damaged:
            channel = int.from_bytes(record.content[:2], "little")
            if channel in self._known.of_ticks():
                self.ticks_lost += (len(record.content) - 6) // 16

    def _flush(self) -> None:
        """Write messages that stood outside chunks."""
        if self._loose:
            data, self._loose, self._loose_bytes = b"".join(self._loose), [], 0
            self._write(data, split(data)[0])

    def _write(self, data: bytes, table: MessageTable) -> None:
        self._name(table)
        parts = [data[o : o + n] for o, n in zip(table.offset.tolist(), table.length.tolist(), strict=True)]
        offset = np.cumsum(table.length) - table.length
        self.file.add_chunk(b"".join(parts), table.channel, table.log_time, offset)
        self._count(table)

    def _describe(self, records: list[Record]) -> None:
        """Take over schemas and channels that stand within a chunk: other programs write them there."""
        for found in self._known.further(records):
            if isinstance(found, Channel):
                self.file.add_channel(found)
            else:
                self.file.add_schema(found)

    def _name(self, table: MessageTable) -> None:
        """Describe channels whose description is lost, so that the messages can stay."""
        for number in np.unique(table.channel).tolist():
            if number not in self._known.channels:
                self.file.add_channel(self._known.unknown(number))
                self.remarks.append(f"the description of channel {number} is lost")

    def _is_tick(self, table: MessageTable) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
        return np.isin(table.channel, self._known.of_ticks())

    def _count(self, table: MessageTable) -> None:
        self.ticks += int(np.count_nonzero(self._is_tick(table)))


def salvage(path: str | os.PathLike[str], out: str | os.PathLike[str]) -> SalvageReport:
    """Write to `out` a valid log with all that is readable in `path`.

    Raises
    ------
    LogError
        `path` is missing or no log of ours, cut before its first record; or `out` exists, or cannot be
        written.

    """
    source, target = Path(path), Path(out)
    try:
        with open_regular(source) as file:
            head, size = file.read(len(MAGIC)), file.seek(0, 2)
        if head != MAGIC:
            raise LogError(f"{source}: not an MCAP file: nothing to salvage")
        descriptions = Descriptions(source)
    except OSError as error:
        raise LogError(f"{source}: cannot be read: {error.strerror}") from error
    if os.path.lexists(target):
        raise LogError(f"{target}: exists and is never overwritten: choose another name")
    temporary = target.with_name(f".{target.name}.{os.getpid()}.part")
    try:
        temporary.unlink(missing_ok=True)
        work = _Salvage(temporary, source, size, descriptions)
        try:
            work.work()
            report = _close(work, source, target, size)
        finally:
            work.file.close()
        _give_name(temporary, target)
    except FileExistsError:
        raise LogError(f"{target}: exists and is never overwritten: choose another name") from None
    except OSError as error:
        raise LogError(f"{target}: cannot be written: {error.strerror}") from error
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink()
    return report


def _give_name(temporary: Path, target: Path) -> None:
    """Give a file its name without taking it from one that came to be meanwhile."""
    try:
        os.link(temporary, target)
    except FileExistsError:
        raise
    except OSError:  # a file system without links
        if os.path.lexists(target):
            raise FileExistsError from None
        temporary.rename(target)


def _close(work: _Salvage, source: Path, target: Path, size: int) -> SalvageReport:
    remarks = work.remarks[:_REMARKS]
    if len(work.remarks) > _REMARKS:
        remarks.append(f"and {len(work.remarks) - _REMARKS} places more")
    told = (work.end or {}).get("ticks", "")
    if not remarks and told.isdecimal() and told != str(work.ticks):
        remarks.append(f"its end counts {told:.20} ticks, {work.ticks} are there")
    report = SalvageReport(
        path=source,
        out=target,
        ticks=work.ticks,
        messages=work.file.messages,
        chunks=work.chunks,
        partial_messages=work.partial,
        bytes_read=size,
        bytes_lost=work.lost,
        complete=work.end is not None and not work.lost and not remarks,
        remarks=tuple(remarks),
        ticks_lost=work.ticks_lost,
    )
    work.file.add_metadata(
        SALVAGE,
        {
            "original": source.name,
            "original_bytes": str(size),
            "bytes_lost": str(work.lost),
            "ticks_lost": str(work.ticks_lost),
            "remarks": "; ".join(remarks),
        },
    )
    end = work.end or {}
    if not report.complete:
        end["ticks"] = str(work.ticks)
        if end.get("closed", CLEAN) == CLEAN:
            end["closed"] = "salvaged"
    work.file.add_metadata(SUMMARY, end)
    work.file.finish()
    return report
