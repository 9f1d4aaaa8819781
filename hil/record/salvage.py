"""Makes a valid log from a truncated or damaged one: power loss, full disk, killed recorder, bit errors.

The original is only read; the result is a new file. It has the messages of each chunk with a valid checksum,
and the complete ticks of a truncated chunk; schemas and channels come from our own code. After a damaged
length the search continues at the next chunk, or at the description of the run.
"""

import contextlib
import os
import re
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Schema

from drivers.errors import LogError
from drivers.files import open_regular
from hil.record.encode import channels_of
from hil.record.environment import product_version
from hil.record.mcap_file import MAGIC, McapFile, record_bytes
from hil.record.mcap_read import NOTHING, Allowance, Record, messages_in, record_at, records
from hil.record.row import OLD, REFUSED, Run, Table, why
from hil.record.schema import CLEAN, IDENTITY, LIBRARY, SALVAGE, SUMMARY

_EXISTS = "exists and is never overwritten: choose another name"

_BEGIN = re.compile(
    rb"(?=\x06[\s\S]{36}(?:\x04\0\0\0zstd|\x03\0\0\0lz4)|\x0c[\s\S]{8}\x03\0\0\0" + IDENTITY.encode() + b")"
)
"""Start of a chunk, or of the metadata record of the run."""
_BEGIN_BYTES = 45
_WINDOW = 1 << 20
_REMARKS = 20
"""Most remarks that are written into the log and reported; further damage is only counted."""


class Lost(NamedTuple):
    """Bytes that belong to no valid record."""

    start: int
    stop: int


def surviving(path: Path) -> Iterator[Record | Lost]:
    """Records of the data section in order, and the lost bytes between them.

    A record is accepted if the next record may be valid, if its own content and checksum are valid, or if
    no valid record follows. A truncated record comes last and is not complete.

    Raises LogError: more bytes to unpack than allowed; OSError.
    """
    with open_regular(path) as file:
        at, size = len(MAGIC), file.seek(0, os.SEEK_END)
        allowance = Allowance(size)
        while at < size:
            record = record_at(file, at)
            sound = record.complete and (
                record.end == size or record_at(file, record.end).complete or _is_whole(record, allowance)
            )
            further = None if sound else _next(file, at + 1, size, allowance)
            if further is not None or record.opcode == NOTHING:
                yield Lost(at, further or size)
                at = further or size
            elif record.opcode == Opcode.DATA_END and record.length == 4:
                return
            else:
                yield record
                at = record.end


def _is_whole(record: Record, allowance: Allowance) -> bool:
    """True if a complete record has no missing or extra byte, and its checksum holds."""
    allowance.spend(len(record.content))
    with contextlib.suppress(LogError):
        found = record.parse()
        if isinstance(found, Chunk):
            messages_in(record, allowance)
        return found is not None and record_bytes(found) == record.whole
    return False


def _next(file: BinaryIO, start: int, size: int, allowance: Allowance) -> int | None:
    """Byte offset of the next undamaged chunk or description of the run; None without one."""
    for at in range(start, size, _WINDOW):
        file.seek(at)
        for found in _BEGIN.finditer(file.read(_WINDOW + _BEGIN_BYTES)):
            record = record_at(file, at + found.start())
            if record.complete and _is_whole(record, allowance):
                return record.offset
    return None


@dataclass
class SalvageReport:
    """Recovered and lost parts of a log. Mutable until the salvage is complete."""

    out: Path
    ticks: int = 0
    bytes_lost: int = 0
    """Bytes of the original that could not be recovered."""
    ticks_lost: int = 0
    """Ticks in damaged chunks, as far as their message indexes count them."""
    remarks: tuple[str, ...] = ()


def _described(path: Path) -> tuple[dict[str, str], dict[int, str]]:
    """Description of a log's run, and topic by number of each channel before its messages.

    Raises LogError if nothing shows that it is a log of this product; OSError.
    """
    identity: dict[str, str] = {}
    topics: dict[int, str] = {}
    for record in surviving(path):
        if isinstance(record, Lost) or record.opcode not in {Opcode.METADATA, Opcode.CHANNEL, Opcode.CHUNK}:
            continue
        if record.opcode == Opcode.CHUNK and identity:
            break
        with contextlib.suppress(LogError):
            found = record.parse()
            if isinstance(found, Channel):
                topics.setdefault(found.id, found.topic)
            elif record.opcode == Opcode.METADATA and found.name == IDENTITY:
                identity = identity or dict(found.metadata)
    if "dtype" in identity:
        raise LogError(f"{path}: {OLD}")
    if "columns" not in identity:
        raise LogError(
            f"{path}: not a log of this product, or cut within its first bytes: nothing to salvage"
        )
    return identity, topics


class _Salvage:
    """A salvage of one log in progress. State: the new file, and the findings so far.

    Raises OSError.
    """

    def __init__(self, source: Path, size: int, file: McapFile, out: Path, rows: Collection[int]) -> None:
        """source: log of `size` bytes; file: the new log; out: its name; rows: channels that hold rows."""
        self.source, self.size, self.file, self.report = source, size, file, SalvageReport(out)
        self.remarks: list[str] = []
        self._allowance, self._rows = Allowance(size), list(rows)
        self._end: dict[str, str] | None = None
        """Summary of the run in the original."""
        self._damaged = False
        """True if the next message index belongs to a chunk that is left out."""

    def work(self) -> None:
        """Copy the readable records of the original to the new log."""
        for record in surviving(self.source):
            if isinstance(record, Lost):
                start, stop = record
                self._lose(stop - start, f"bytes {start} to {stop} are damaged and left out")
                continue
            try:
                self._add(record)
            except LogError as error:
                self._damaged = record.opcode == Opcode.CHUNK
                self._lose(len(record.whole), f"left out: {error}")
        if not self.remarks:
            try:  # metadata records have no checksum
                for _ in records(self.source, cut=True):
                    pass
            except LogError as error:
                self.remarks.append(f"{error}: the copied content may be damaged")

    def _lose(self, size: int, remark: str) -> None:
        self.report.bytes_lost += size
        self.remarks.append(remark)

    def _add(self, record: Record) -> None:
        found: Any = record.parse() if record.complete else None
        if record.opcode == Opcode.CHUNK:
            self._chunk(record)
        elif not record.complete:
            self._lose(len(record.whole), f"the file ends inside a record at byte {record.offset}")
        elif record.opcode == Opcode.MESSAGE:
            raise record.damaged("a message outside a chunk, which no recorder writes")
        elif record.opcode == Opcode.MESSAGE_INDEX:
            if self._damaged and int.from_bytes(record.content[:2], "little") in self._rows:
                self.report.ticks_lost += (len(record.content) - 6) // 16
        elif record.opcode == Opcode.ATTACHMENT:
            self.file.add_attachment(found.name, found.data, found.log_time, found.media_type)
        elif record.opcode == Opcode.METADATA and found.name == SUMMARY:
            self._end = dict(found.metadata)
        elif record.opcode == Opcode.METADATA and found.name != IDENTITY:
            self.file.add_metadata(found.name, found.metadata)

    def _chunk(self, record: Record) -> None:
        """Copy a chunk; of a truncated chunk only the complete ticks, since replay needs whole ticks."""
        data, table, _ = messages_in(record, self._allowance)
        begun = np.flatnonzero(np.isin(table.channel, self._rows))
        if not record.complete:
            table, begun = table.before(begun), begun[:-1]
        if count := len(table.channel):
            end = int(table.offset[-1] + table.length[-1])
            self.file.add_chunk(data[:end], table.channel, table.log_time, table.offset)
        self.report.ticks += len(begun)
        if record.complete:
            self._damaged = False
        else:
            where = f"the file ends inside the chunk at byte {record.offset}"
            self._lose(len(record.whole), f"{where}: {count} messages of it recovered")

    def close(self) -> None:
        """Write a record of the losses and the summary of the run, and close the new log."""
        report, end, remarks = self.report, self._end or {}, self.remarks[:_REMARKS]
        if len(self.remarks) > _REMARKS:
            remarks.append(f"and {len(self.remarks) - _REMARKS} more places")
        counted = end.get("ticks", "")
        if not remarks and counted.isdecimal() and counted != str(report.ticks):
            remarks.append(f"its summary counts {counted:.20} ticks, but {report.ticks} are present")
        report.remarks = tuple(remarks)
        self.file.add_metadata(
            SALVAGE,
            {
                "original": self.source.name,
                "original_bytes": self.size,
                "bytes_lost": report.bytes_lost,
                "ticks_lost": report.ticks_lost,
                "remarks": "; ".join(remarks),
            },
        )
        if self._end is None or remarks:
            end["ticks"] = str(report.ticks)
            if end.get("closed", CLEAN) == CLEAN:
                end["closed"] = "salvaged"
        self.file.add_metadata(SUMMARY, end)
        self.file.finish()


def salvage(path: str | os.PathLike[str], out: str | os.PathLike[str]) -> SalvageReport:
    """Write to `out` a valid log with all readable content of `path`.

    Raises LogError: `path` is missing, not a log of this product, cut before its first record, or its table
    of columns is damaged; or `out` exists, or cannot be written.
    """
    source, target = Path(path), Path(out)
    try:
        with open_regular(source) as opened:
            head, size = opened.read(len(MAGIC)), opened.seek(0, os.SEEK_END)
        if head != MAGIC:
            raise LogError(f"{source}: not an MCAP file: nothing to salvage")
        identity, topics = _described(source)
        run = Run.of(identity)
    except OSError as error:
        raise LogError(f"{source}: cannot be read: {error.strerror}") from error
    except REFUSED as error:
        raise LogError(
            f"{source}: the description of its run is damaged: nothing to salvage: {why(error)}"
        ) from None
    if os.path.lexists(target):
        raise LogError(f"{target}: {_EXISTS}")
    own = channels_of(Table(run.topic, run.columns), run.can_channels)
    known = {topic: number for number, (topic, *_) in own.items()}
    numbers = {n: n for n in own} | {n: known[topic] for n, topic in topics.items() if topic in known}
    temporary = target.with_name(f".{target.name}.{os.getpid()}.part")
    try:
        try:
            temporary.unlink(missing_ok=True)
            file = McapFile(temporary, f"{LIBRARY}/{product_version()}")
            try:
                file.add_metadata(IDENTITY, identity)
                for number, (_, schema, _) in own.items():
                    file.add(Schema(number, schema.descriptors, "protobuf", schema.name))
                for number, k in numbers.items():
                    file.add(Channel(number, own[k][0], "protobuf", own[k][2], k))
                rows = [n for n, k in numbers.items() if k == known[run.topic]]
                work = _Salvage(source, size, file, target, rows)
                work.work()
                work.close()
            finally:
                file.close()
            _give_name(temporary, target)
        finally:
            temporary.unlink(missing_ok=True)
    except FileExistsError:
        raise LogError(f"{target}: {_EXISTS}") from None
    except OSError as error:
        raise LogError(f"{target}: cannot be written: {error.strerror}") from error
    return work.report


def _give_name(temporary: Path, target: Path) -> None:
    """Rename a complete file to `target`. Raises FileExistsError if this name was taken meanwhile."""
    try:
        os.link(temporary, target)
    except FileExistsError:
        raise
    except OSError:  # a file system without links
        if os.path.lexists(target):
            raise FileExistsError from None
        temporary.rename(target)
