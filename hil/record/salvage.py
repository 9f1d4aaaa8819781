"""Makes a valid log of one that was cut or damaged: power loss, full disk, recorder killed, bits turned over.

The original is read, never touched; the result is a new file, which gets its name when it is whole. Complete
chunks are copied as they are; of a chunk that is cut, the ticks that are complete. Schemas and channels stand
twice in a log: a damaged one is taken from the other place, or made from our own code.
"""

import contextlib
import os
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Channel, Metadata
from mcap.records import Schema as SchemaRecord
from numpy.typing import NDArray

from drivers.errors import LogError
from drivers.regular_file import open_regular
from hil.record.decode import CAN, OPERATOR, REFUSED
from hil.record.environment import product_version
from hil.record.mcap_file import MAGIC, McapFile
from hil.record.mcap_read import Allowance, MessageTable, Record, messages_in, records
from hil.record.row import TICKS, Table, columns_in, describe, row_schema
from hil.record.schema import (
    CLEAN,
    IDENTITY,
    LIBRARY,
    SALVAGE,
    SUMMARY,
    Schema,
    frame_schema,
    message_class,
    operator_schema,
)
from hil.record.surviving import Lost, surviving

_DESCRIPTIONS = frozenset({Opcode.METADATA, Opcode.SCHEMA, Opcode.CHANNEL})
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


class _Described:
    """What a log says of itself: identity, schemas and channels, each from the first sound place.

    Raises LogError where nothing says that it is a log of this product; OSError.
    """

    def __init__(self, path: Path) -> None:
        self.remarks: list[str] = []
        self.identity: dict[str, str] = {}
        self.schemas: dict[int, SchemaRecord] = {}
        self.channels: dict[int, Channel] = {}
        for record in surviving(path):
            if isinstance(record, Record) and record.complete and record.opcode in _DESCRIPTIONS:
                with contextlib.suppress(LogError):
                    self._learn(record.parse())
        if not self.identity:
            raise LogError(
                f"{path}: no log of this product, or cut within its first bytes: nothing to salvage"
            )
        try:
            columns = columns_in(self.identity)
        except REFUSED as error:
            if self.identity.get("topic") != TICKS.topic or "columns" not in self.identity:
                raise LogError(
                    f"{path}: its table of columns is damaged: nothing to salvage: {error}"
                ) from None
            columns, self.identity["columns"] = TICKS.columns, describe(TICKS.columns)
            self.remarks.append("the table of columns is damaged; that of this version takes its place")
        rows = Table(self.identity.get("topic", ""), columns)
        own: dict[str, Callable[[], Schema]]
        own = {CAN: frame_schema, OPERATOR: operator_schema, rows.topic: partial(row_schema, rows)}
        for channel in self.channels.values():
            self._give_schema(channel, own.get(channel.topic))

    def _learn(self, found: Metadata | SchemaRecord | Channel) -> None:
        if isinstance(found, Channel):
            self.channels.setdefault(found.id, found)
        elif isinstance(found, SchemaRecord):
            if found.id and not _usable(self.schemas.get(found.id)):
                self.schemas[found.id] = found
        elif found.name == IDENTITY and {"columns", "dtype"} & found.metadata.keys():
            self.identity = self.identity or dict(found.metadata)

    def _give_schema(self, channel: Channel, own: Callable[[], Schema] | None) -> None:
        """See to it that a channel has a schema that can be used, or none."""
        number = channel.schema_id
        if not number or _usable(self.schemas.get(number)):
            return
        if own is None:
            self.remarks.append(f"the schema of {channel.topic} is lost")
            self.schemas.pop(number, None)
            channel.schema_id = 0
            return
        self.remarks.append(f"the schema of {channel.topic} is damaged; that of this version takes its place")
        name, descriptors = own()
        self.schemas[number] = SchemaRecord(id=number, name=name, encoding="protobuf", data=descriptors)


def _usable(schema: SchemaRecord | None) -> bool:
    """Return whether messages can be read by a schema."""
    try:
        if schema is not None and schema.encoding == "protobuf":
            message_class(Schema(schema.name, bytes(schema.data)))
    except REFUSED:
        return False
    return schema is not None


class _Salvage:
    """One salvage at work. State: the new file, and what was found so far."""

    def __init__(self, out: Path, source: Path, size: int, described: _Described) -> None:
        self.file = McapFile(out, f"{LIBRARY}/{product_version()}")
        self.end: dict[str, str] | None = None
        """What the run has said of its end."""
        self.chunks = self.ticks = self.partial = self.lost = self.ticks_lost = 0
        self.remarks = described.remarks
        self._source, self._known, self._allowance = source, described, Allowance(size)
        topic = described.identity.get("topic")
        self._rows = [number for number, channel in described.channels.items() if channel.topic == topic]
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
            elif record.opcode == Opcode.DATA_END and (len(record.content) == 4 or not record.complete):
                break
            else:
                self._add(record)
        if not self.lost and not self.remarks:
            try:  # metadata and the names of schemas and channels have no checksum of their own
                for _ in records(self._source):
                    pass
            except LogError as error:
                self.remarks.append(f"{error}: what was taken over may hold the damage")

    def _add(self, record: Record) -> None:
        if record.opcode != Opcode.MESSAGE_INDEX:
            self._damaged = False
        try:
            if record.opcode == Opcode.CHUNK:
                self._chunk(record)
            elif not record.complete:
                self._lose(record, f"the file ends inside a record at byte {record.offset}")
            elif record.opcode == Opcode.MESSAGE_INDEX:
                self._index(record)
            else:
                self._other(record)
        except LogError as error:
            self._damaged = record.opcode == Opcode.CHUNK
            what = "the chunk" if self._damaged else "the record"
            self._lose(record, f"{what} at byte {record.offset} is damaged and left out: {error}")

    def _lose(self, record: Record, remark: str) -> None:
        self.lost += len(record.whole)
        self.remarks.append(remark)

    def _other(self, record: Record) -> None:
        found = record.parse()
        if record.opcode == Opcode.MESSAGE:
            raise LogError("a message outside a chunk, which no recorder writes")
        if record.opcode == Opcode.ATTACHMENT:
            self.file.add_attachment(found.name, found.data, found.log_time, found.media_type)
        elif record.opcode == Opcode.METADATA and found.name == SUMMARY:
            self.end = dict(found.metadata)
        elif record.opcode == Opcode.METADATA and found.name != IDENTITY:
            self.file.add_metadata(found.name, found.metadata)

    def _chunk(self, record: Record) -> None:
        """Copy a chunk; of one that is cut, the whole ticks, which are what replay needs."""
        data, table, _ = messages_in(record, self._allowance)
        if record.complete:
            self.file.add_compressed(record.parse(), table.channel, table.log_time, table.offset)
            self.chunks += 1
        else:
            table = table.before(self._ticks(table))
            self.partial = len(table.channel)
            if self.partial:
                end = int(table.offset[-1] + table.length[-1])
                self.file.add_chunk(data[:end], table.channel, table.log_time, table.offset)
            what = f"the file ends inside the chunk at byte {record.offset}"
            self._lose(record, f"{what}: {self.partial} messages of it recovered")
        self.ticks += len(self._ticks(table))

    def _index(self, record: Record) -> None:
        """Count the ticks of a chunk that is left out."""
        if self._damaged and int.from_bytes(record.content[:2], "little") in self._rows:
            self.ticks_lost += (len(record.content) - 6) // 16

    def _ticks(self, table: MessageTable) -> NDArray[np.intp]:
        return np.flatnonzero(np.isin(table.channel, self._rows))


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
        described = _Described(source)
    except OSError as error:
        raise LogError(f"{source}: cannot be read: {error.strerror}") from error
    if os.path.lexists(target):
        raise LogError(f"{target}: exists and is never overwritten: choose another name")
    temporary = target.with_name(f".{target.name}.{os.getpid()}.part")
    try:
        temporary.unlink(missing_ok=True)
        work = _Salvage(temporary, source, size, described)
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
