"""Reads a log: configuration, metadata, and the ticks in their order."""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Chunk

from drivers.arrays import Rows
from drivers.errors import LogError
from drivers.protocol import BUS, Frame, Received
from drivers.tick_columns import Column
from hil.record.decode import CAN, EVENTS, ITEM, OPERATOR, Decoder
from hil.record.layout import MAX_DATA
from hil.record.mcap_file import MAGIC
from hil.record.mcap_read import MessageTable, Record, decompress, records, split
from hil.record.row import Table, columns_of, columns_of_0_1_0
from hil.record.schema import CONFIGURATION, IDENTITY, RX, SUMMARY, TX
from hil.signals import Operator, SetPoint

_BATCH, _LOOKAHEAD = 256, 64
"""Ticks read before any is handed out, and how far other writers may have moved a message."""
_MESSAGES = frozenset({Opcode.MESSAGE, Opcode.CHUNK, Opcode.MESSAGE_INDEX})
_FOOTER = 9 + 20 + len(MAGIC)
_LEVELS = {1: "debug", 2: "info", 3: "warning", 4: "error", 5: "error"}


Commands = dict[int, list[tuple[int, int, tuple[float, ...]]]]
"""By tick: index, command and the pose of a set-point."""


class Tick(NamedTuple):
    """One recorded tick."""

    row: np.void
    """One element of `Log.dtype`."""
    received: tuple[Received, ...]
    """In the order consumed."""
    sent: tuple[Frame, ...]
    operator: tuple[int, ...]
    setpoints: tuple[SetPoint, ...] = ()


class Event(NamedTuple):
    """One recorded event."""

    t_ns: int
    level: str
    text: str


class LogStatistics(NamedTuple):
    """What is in a log."""

    ticks: int
    frames: int
    duration_s: float
    dropped: int
    """Ticks that the recorder had to drop."""
    closed: str
    """`clean`, `producer died`, `salvaged`, or `unknown`."""


class Log:
    """A log of ours; open one with `Log.open`."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.metadata: dict[str, dict[str, str]] = {}
        self.attachments: dict[str, bytes] = {}
        self._decoder = Decoder(str(path))

    @classmethod
    def open(cls, path: str | os.PathLike[str]) -> Log:
        """Open a log and read all but its messages.

        Raises
        ------
        LogError
            No such file, no MCAP, cut, damaged, or not written by this product.

        """
        log = cls(Path(path))
        log._check_file()
        for record in records(log.path, skip=_MESSAGES):
            log._learn(record)
        identity = log.metadata.get(IDENTITY, {})
        if not {"columns", "dtype"} & identity.keys():
            raise LogError(
                f"{path}: an MCAP file, but not a log of this product (no metadata record {IDENTITY!r})"
            )
        try:
            log.columns = (
                columns_of(identity["columns"])
                if "columns" in identity
                else columns_of_0_1_0(identity["dtype"])
            )
            log.topic, log.epoch_ns = identity["topic"], int(identity["epoch_ns"])
            log.lockstep = identity["mode"] == "lockstep"
            log.dtype = Table(log.topic, log.columns).dtype
            log._decoder.expect(log.topic, log.columns, identity["can_channel"], log.epoch_ns)
        except (AttributeError, KeyError, OverflowError, TypeError, ValueError) as error:
            raise LogError(f"{path}: metadata record {IDENTITY!r} cannot be read: {error!r}") from error
        return log

    columns: tuple[Column, ...]
    """Of the rows; without names of elements and numbers where version 0.1.0 wrote the log."""
    dtype: np.dtype[np.void]
    """Type of the rows."""
    topic: str
    """Topic of the rows: `/tick` or `/plant`."""
    epoch_ns: int
    """UTC of t_ns = 0."""
    lockstep: bool

    @property
    def configuration(self) -> str:
        """Text of the configuration of the run.

        Raises
        ------
        LogError
            The log has none, or one that is no text.

        """
        if CONFIGURATION not in self.attachments:
            raise LogError(
                f"{self.path}: no attachment {CONFIGURATION}: the configuration of the run is not known"
            )
        try:
            return self.attachments[CONFIGURATION].decode()
        except UnicodeDecodeError as error:
            raise LogError(f"{self.path}: attachment {CONFIGURATION} is no text: {error}") from error

    @property
    def summary(self) -> LogStatistics:
        """What is in the log, from its index."""
        try:
            with self.path.open("rb") as file:
                summary = make_reader(file).get_summary()
        except (McapError, struct.error, UnicodeDecodeError) as error:
            raise LogError(
                f"{self.path}: damaged index: {error}; run `hil replay --salvage` on it"
            ) from error
        statistics = summary.statistics if summary else None
        if summary is None or statistics is None:
            raise LogError(f"{self.path}: no index at the end: run `hil replay --salvage` on it")
        counts = {
            channel.topic: statistics.channel_message_counts.get(i, 0)
            for i, channel in summary.channels.items()
        }
        closing = self.metadata.get(SUMMARY, {})
        return LogStatistics(
            ticks=counts.get(self.topic, 0),
            frames=counts.get(CAN, 0),
            duration_s=(statistics.message_end_time - statistics.message_start_time) * 1e-9,
            dropped=int(closing.get("dropped", 0)),
            closed=closing.get("closed", "unknown"),
        )

    def rows(self) -> Rows:
        """Return all rows, in tick order."""
        parts = [self._decoder.rows(data, table) for data, table in self._buffers()]
        rows = np.concatenate(parts) if parts else np.zeros(0, self.dtype)
        return rows[np.argsort(rows["tick"], kind="stable")]

    def events(self) -> list[Event]:
        """Return all events, in the order of the file."""
        found = []
        for data, table in self._buffers():
            for message in self._decoder.messages(data, table, EVENTS):
                t_ns = message.timestamp.seconds * 1_000_000_000 + message.timestamp.nanos - self.epoch_ns
                found.append(Event(t_ns, _LEVELS.get(message.level, "info"), message.message))
        return found

    def ticks(self) -> Iterator[Tick]:
        """Yield the ticks in their order, reading as it goes.

        Raises
        ------
        LogError
            The file is damaged, or another program has moved messages too far from their tick.

        """
        rows = np.zeros(0, self.dtype)
        items = np.zeros(0, ITEM)
        commands: Commands = {}
        done = -1
        for data, table in self._buffers():
            rows = np.concatenate((rows, self._decoder.rows(data, table)))
            items = np.concatenate((items, self._decoder.frames(data, table)))
            for message in self._decoder.messages(data, table, OPERATOR):
                if message.command == Operator.SETPOINT and len(message.setpoint) != len(SetPoint._fields):
                    raise LogError(f"{self.path}: the set-point of tick {message.tick} has no six words")
                commands.setdefault(message.tick, []).append(
                    (message.index, message.command, tuple(message.setpoint))
                )
            if len(rows) < _BATCH:
                continue
            rows = self._sorted(rows, items, done)
            ready, rows = rows[:-_LOOKAHEAD], rows[-_LOOKAHEAD:]
            done = int(ready["tick"][-1])
            mine = items["tick"] <= done
            yield from _assemble(ready, items[mine], commands)
            items = items[~mine]
        yield from _assemble(self._sorted(rows, items, done), items, commands)

    def _sorted(self, rows: Rows, items: Rows, done: int) -> Rows:
        """Return rows in tick order; refuse what belongs to ticks up to `done`, already handed out."""
        ticks = np.concatenate((rows["tick"], items["tick"]))
        if len(ticks) and int(ticks.min()) <= done:
            raise LogError(f"{self.path}: messages stand more than {_LOOKAHEAD} ticks out of order")
        return rows[np.argsort(rows["tick"], kind="stable")]

    # reading the container
    def _check_file(self) -> None:
        path = self.path
        try:
            with path.open("rb") as file:
                head = file.read(len(MAGIC))
                size = file.seek(0, os.SEEK_END)
                file.seek(max(size - len(MAGIC), 0))
                tail = file.read()
        except FileNotFoundError:
            raise LogError(f"{path}: no such file") from None
        except OSError as error:
            raise LogError(f"{path}: cannot be read: {error.strerror}") from error
        if not head:
            raise LogError(f"{path}: the file is empty")
        if head != MAGIC[: len(head)] or (len(head) == len(MAGIC) and head != MAGIC):
            raise LogError(f"{path}: not an MCAP file")
        if size < len(MAGIC) + _FOOTER or tail != MAGIC:
            raise LogError(
                f"{path}: cut at {size} bytes, the end is missing (power loss, or the recorder was killed): "
                "run `hil replay --salvage` on it to recover what is there"
            )

    def _learn(self, record: Record) -> None:
        """Keep what is not a message."""
        if record.opcode in _MESSAGES:
            return
        found = self._parse(record)
        match type(found).__name__:
            case "Metadata":
                self.metadata[found.name] = dict(found.metadata)
            case "Attachment":
                self.attachments[found.name] = bytes(found.data)
            case "Schema" | "Channel":
                self._decoder.learn(found)

    def _parse(self, record: Record) -> Any:
        try:
            if record.complete:
                return record.parse()
        except (McapError, struct.error, UnicodeDecodeError) as error:
            raise LogError(f"{self.path}: damaged at byte {record.offset}: {error}") from error
        raise LogError(f"{self.path}: cut at byte {record.offset}: run `hil replay --salvage` on it")

    def _buffers(self) -> Iterator[tuple[bytes, MessageTable]]:
        """Yield buffers of messages: the chunks, or runs of messages that stand outside chunks."""
        loose: list[bytes] = []
        for record in records(self.path):
            if record.opcode == Opcode.MESSAGE:
                loose.append(record.whole)
                if len(loose) < 4096:
                    continue
            if loose:
                data, loose = b"".join(loose), []
                yield data, split(data)[0]
            if record.opcode == Opcode.CHUNK:
                chunk: Chunk = self._parse(record)
                try:
                    data = decompress(chunk)
                except LogError as error:
                    raise LogError(f"{self.path}: damaged at byte {record.offset}: {error}") from error
                table, others = split(data)
                for other in others:
                    self._learn(other)
                yield data, table
        if loose:
            data = b"".join(loose)
            yield data, split(data)[0]


def _assemble(rows: Rows, items: Rows, commands: Commands) -> Iterator[Tick]:
    """Yield the ticks of `rows`, with their items."""
    items = items[np.lexsort((items["index"], items["direction"], items["tick"]))]
    width = MAX_DATA
    data = np.ascontiguousarray(items["data"]).tobytes()
    starts = range(0, len(data), width)
    contents = [data[a : a + n] for a, n in zip(starts, items["length"].tolist(), strict=True)]
    flags = items["flags"] + items["bus"].astype(np.int64) * BUS
    frames = list(map(Frame, items["id"].tolist(), contents, flags.tolist()))
    received = list(map(Received, items["t_ns"].tolist(), frames))
    key = items["tick"] * 4 + items["direction"]
    wanted = rows["tick"] * 4
    first, middle, last = (np.searchsorted(key, wanted + k).tolist() for k in (RX, TX, TX + 1))
    for row, tick, a, b, c in zip(rows, rows["tick"].tolist(), first, middle, last, strict=True):
        tick_received, tick_sent = tuple(received[a:b]), tuple(frames[b:c])
        if tick not in commands:
            yield Tick(row, tick_received, tick_sent, ())
            continue
        given = sorted(commands[tick])
        operator = tuple(command for _, command, _ in given if command != Operator.SETPOINT)
        setpoints = tuple(SetPoint(*pose) for _, command, pose in given if command == Operator.SETPOINT)
        yield Tick(row, tick_received, tick_sent, operator, setpoints)
