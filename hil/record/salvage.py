"""Makes a valid log of one that was cut or damaged: power loss, full disk, recorder killed, bits turned over.

The original is read, never touched; the result is a new file. Complete chunks are copied as they are; of a
chunk that is cut, the ticks that are complete. Schemas and channels are those of our own code.

A record counts where a sound one follows, or where its own checksum holds. Else the next place is looked for
at which two sound records stand behind each other.
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
from mcap.records import Attachment, Channel, Chunk, Schema

from drivers.errors import LogError
from drivers.files import open_regular
from hil.record.decode import REFUSED, why
from hil.record.encode import channels_of
from hil.record.environment import product_version
from hil.record.mcap_file import MAGIC, McapFile, record_bytes
from hil.record.mcap_read import (
    HEAD,
    OPCODES,
    Allowance,
    Record,
    decompress,
    longest,
    messages_in,
    records,
)
from hil.record.row import OLD, TICKS, Run, Table, describe
from hil.record.schema import CLEAN, IDENTITY, LIBRARY, SALVAGE, SUMMARY

_BEGIN = re.compile(rb"(?=[\x01-\x0f][\s\S]{4}\x00{4})")
"""A known opcode and a length below 4 GiB."""
_WINDOW = 1 << 20
_REMARKS = 20
"""Written into the log and reported; of more damage the number is."""


class Lost(NamedTuple):
    """Bytes that belong to no valid record."""

    start: int
    stop: int


def surviving(path: Path) -> Iterator[Record | Lost]:
    """Yield the records of the data section in their order, and what lies between them.

    A record whose end is cut off comes last and is not complete.

    Raises OSError.
    """
    with open_regular(path) as file:
        size = file.seek(0, os.SEEK_END)
        at = len(MAGIC)
        while at < size:
            record, further = _record(file, at), None
            end = size if record is None else at + len(record.whole)
            if record is None or not (record.complete and (_sound(file, end, size) or _verified(record))):
                further = _next(file, at + 1, end, size)
            if record is not None and further is None:
                if record.opcode == Opcode.DATA_END and (len(record.content) == 4 or not record.complete):
                    return
                yield record
            else:
                end = size if further is None else further
                yield Lost(at, end)
            at = end


def _record(file: BinaryIO, at: int) -> Record | None:
    """Return what may be a record, complete or not."""
    file.seek(at)
    head = file.read(HEAD.size)
    if len(head) < HEAD.size:
        return None
    opcode, length = HEAD.unpack(head)
    if opcode not in OPCODES or length > longest(opcode):
        return None
    content = file.read(length)
    return Record(opcode, at, content, len(content) == length)


def _sound(file: BinaryIO, at: int, size: int) -> bool:
    """Return whether the file ends there, or something stands there that may be a record within it."""
    record = _record(file, at)
    return at + HEAD.size > size if record is None else record.complete


def _verified(record: Record) -> bool:
    """Return whether a record's own checksum says that it is whole."""
    try:
        found = record.parse()
        if isinstance(found, Chunk):
            decompress(found)
            return bool(found.uncompressed_crc) and record_bytes(found) == record.whole
        return isinstance(found, Attachment) and record_bytes(found) == record.whole
    except LogError:
        return False


def _next(file: BinaryIO, start: int, stop: int, size: int) -> int | None:
    """Return the first place from `start` to before `stop` at which two sound records begin; None without."""
    for at in range(start, stop, _WINDOW):
        file.seek(at)
        for found in _BEGIN.finditer(file.read(_WINDOW + HEAD.size - 1)):
            place = at + found.start()
            record = _record(file, place) if place < stop else None
            if record is not None and record.complete and _sound(file, place + len(record.whole), size):
                return place
    return None


@dataclass
class SalvageReport:
    """What was recovered and what was lost. Mutable while the salvage is at work."""

    path: Path
    out: Path
    bytes_read: int
    ticks: int = 0
    messages: int = 0
    chunks: int = 0
    """Complete chunks."""
    partial_messages: int = 0
    """Messages recovered from a chunk that was cut."""
    bytes_lost: int = 0
    """Bytes of the original that gave nothing."""
    complete: bool = False
    """Nothing but the index at the end was missing."""
    remarks: tuple[str, ...] = ()
    ticks_lost: int = 0
    """Ticks of damaged chunks, as far as the index behind them counts them."""


def _described(path: Path) -> tuple[dict[str, str], dict[int, str]]:
    """Return what a log says of its run, and the topics of its channels by number.

    Raises LogError where nothing says that it is a log of this product; OSError.
    """
    identity: dict[str, str] = {}
    topics: dict[int, str] = {}
    for record in surviving(path):
        if isinstance(record, Record) and record.opcode in {Opcode.METADATA, Opcode.CHANNEL}:
            with contextlib.suppress(LogError):
                found = record.parse()
                if isinstance(found, Channel):
                    topics.setdefault(found.id, found.topic)
                elif found.name == IDENTITY and {"columns", "dtype"} & found.metadata.keys():
                    identity = identity or dict(found.metadata)
    if not identity:
        raise LogError(f"{path}: no log of this product, or cut within its first bytes: nothing to salvage")
    if "dtype" in identity:
        raise LogError(f"{path}: {OLD}")
    return identity, topics


class _Salvage:
    """One salvage at work. State: the new file, and what was found so far.

    Raises OSError.
    """

    def __init__(self, source: Path, out: Path, size: int, rows: Collection[int]) -> None:
        """Open the new file; rows: the channels of rows."""
        self.file = McapFile(out, f"{LIBRARY}/{product_version()}")
        self.report = SalvageReport(source, out, size)
        self.remarks: list[str] = []
        self._allowance, self._rows = Allowance(size), list(rows)
        self._end: dict[str, str] | None = None
        """What the run has said of its end."""
        self._damaged = False
        """Whether the index that comes next is of a chunk that is left out."""

    def work(self) -> None:
        """Take over what survives of the original."""
        report = self.report
        for record in surviving(report.path):
            if isinstance(record, Lost):
                self._lose(
                    record.stop - record.start,
                    f"bytes {record.start} to {record.stop} are damaged and left out",
                )
                continue
            try:
                self._add(record)
                self._damaged = self._damaged and record.opcode == Opcode.MESSAGE_INDEX
            except LogError as error:
                self._damaged = record.opcode == Opcode.CHUNK
                what = "the chunk" if self._damaged else "the record"
                remark = f"{what} at byte {record.offset} is damaged and left out: {error}"
                self._lose(len(record.whole), remark)
        if not report.bytes_lost and not self.remarks:
            try:  # metadata and the names of schemas and channels have no checksum of their own
                for _ in records(report.path):
                    pass
            except LogError as error:
                self.remarks.append(f"{error}: what was taken over may hold the damage")

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
            raise LogError("a message outside a chunk, which no recorder writes")
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
        """Copy a chunk; of one that is cut, the whole ticks, which are what replay needs."""
        data, table, _ = messages_in(record, self._allowance)
        begun = np.flatnonzero(np.isin(table.channel, self._rows))
        if record.complete:
            self.file.add_compressed(record.parse(), table.channel, table.log_time, table.offset)
            self.report.chunks += 1
            self.report.ticks += len(begun)
            return
        table = table.before(begun)
        count = len(table.channel)
        if count:
            end = int(table.offset[-1] + table.length[-1])
            self.file.add_chunk(data[:end], table.channel, table.log_time, table.offset)
            self.report.ticks += len(begun) - 1
        self.report.partial_messages = count
        what = f"the file ends inside the chunk at byte {record.offset}"
        self._lose(len(record.whole), f"{what}: {count} messages of it recovered")

    def close(self) -> SalvageReport:
        """Write what was lost and how the run ended, and close the file."""
        report, end, remarks = self.report, self._end or {}, self.remarks[:_REMARKS]
        if len(self.remarks) > _REMARKS:
            remarks.append(f"and {len(self.remarks) - _REMARKS} places more")
        told = end.get("ticks", "")
        if not remarks and told.isdecimal() and told != str(report.ticks):
            remarks.append(f"its end counts {told:.20} ticks, {report.ticks} are there")
        report.messages, report.remarks = self.file.messages, tuple(remarks)
        report.complete = self._end is not None and not report.bytes_lost and not remarks
        self.file.add_metadata(
            SALVAGE,
            {
                "original": report.path.name,
                "original_bytes": str(report.bytes_read),
                "bytes_lost": str(report.bytes_lost),
                "ticks_lost": str(report.ticks_lost),
                "remarks": "; ".join(remarks),
            },
        )
        if not report.complete:
            end["ticks"] = str(report.ticks)
            if end.get("closed", CLEAN) == CLEAN:
                end["closed"] = "salvaged"
        self.file.add_metadata(SUMMARY, end)
        self.file.finish()
        return report


def _run_of(identity: dict[str, str]) -> tuple[Run, list[str]]:
    """Return what a log says of its run, and a remark where its table of columns had to be replaced."""
    try:
        return Run.of(identity), []
    except REFUSED:
        if identity.get("topic") != TICKS.topic:
            raise
        identity["columns"] = describe(TICKS.columns)
        return Run.of(identity), ["the table of columns is damaged; that of this version takes its place"]


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
            head, size = file.read(len(MAGIC)), file.seek(0, os.SEEK_END)
        if head != MAGIC:
            raise LogError(f"{source}: not an MCAP file: nothing to salvage")
        identity, topics = _described(source)
        run, remarks = _run_of(identity)
    except OSError as error:
        raise LogError(f"{source}: cannot be read: {error.strerror}") from error
    except REFUSED as error:
        raise LogError(
            f"{source}: what it says of its run is damaged: nothing to salvage: {why(error)}"
        ) from None
    own = channels_of(Table(run.topic, run.columns), run.can_channels)
    known = {topic: number for number, (topic, *_) in own.items()}
    numbers = {n: n for n in own} | {n: known[topic] for n, topic in topics.items() if topic in known}
    temporary = target.with_name(f".{target.name}.{os.getpid()}.part")
    taken = LogError(f"{target}: exists and is never overwritten: choose another name")
    if os.path.lexists(target):
        raise taken
    try:
        temporary.unlink(missing_ok=True)
        rows = [n for n, k in numbers.items() if k == known[run.topic]]
        work = _Salvage(source, temporary, size, rows)
        work.remarks += remarks
        try:
            work.file.add_metadata(IDENTITY, identity)
            for number, (_, schema, _) in own.items():
                work.file.add_schema(Schema(number, schema.descriptors, "protobuf", schema.name))
            for number, k in numbers.items():
                work.file.add_channel(Channel(number, own[k][0], "protobuf", own[k][2], k))
            work.work()
            report = work.close()
            _give_name(temporary, target)
            report.out = target
            return report
        finally:
            work.file.close()
            temporary.unlink(missing_ok=True)
    except FileExistsError:
        raise taken from None
    except OSError as error:
        raise LogError(f"{target}: cannot be written: {error.strerror}") from error


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
