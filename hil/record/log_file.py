"""File of a log: its metadata, its attachments, and its messages, decoded chunk by chunk."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.Log_pb2 import Log as LogMessage
from mcap.opcode import Opcode
from numpy.typing import NDArray

from drivers.arrays import Rows
from drivers.errors import LogError
from drivers.files import open_regular
from drivers.tick_columns import Column
from hil.record.entries import Command, Event
from hil.record.layout import ITEM, RECORD_HEADER, frame_table, unpack_frames, unpack_rows, words_of
from hil.record.mcap_file import MAGIC
from hil.record.mcap_read import Allowance, DamageError, MessageTable, Record, messages_in, record_at, records
from hil.record.row import OLD, REFUSED, RowCodec, Run, Table, completed, why
from hil.record.schema import (
    CAN_TOPIC,
    CONFIGURATION,
    EVENTS_TOPIC,
    IDENTITY,
    LEVEL_NAMES,
    OPERATOR_TOPIC,
    SALVAGE,
    message_class,
    operator_schema,
)
from hil.record.selection import no_column, together
from hil.signals import NUMBERS, Operator

_MESSAGES = frozenset({Opcode.MESSAGE, Opcode.CHUNK, Opcode.MESSAGE_INDEX})
_FOOTER = 9 + 20 + len(MAGIC)
_CLASSES = {OPERATOR_TOPIC: message_class(operator_schema()), EVENTS_TOPIC: LogMessage}
_OPERATORS = frozenset(map(int, Operator))
_SEQUENCE = 0xFFFFFFFF
"""Low 32 bits of a tick: the sequence number of its messages."""
_OTHER_LAYOUT = "its layout is not that of the recorder"
ADVICE, SALVAGED = "run `hil replay --salvage` on it", "it was salvaged before; nothing more is recoverable"
"""Advice in messages about a damaged log, and about one that was salvaged before."""


class LogFile:
    """File of a log. State: metadata, attachments, and the channels seen so far.

    Raises LogError: no such file, not MCAP, damaged, not written by this product, or truncated within its
    first bytes.
    """

    path: Path
    metadata: dict[str, dict[str, str]]
    """Metadata records by name, among them `hil` (run), `environment` (machine) and `summary` (end of the
    run).
    """
    attachments: dict[str, bytes]
    """Attached files by name: configuration, protocol database, and every other input of a replay."""
    cut: str
    """Reason why the file is incomplete; empty for a complete file."""
    columns: tuple[Column, ...]
    """Columns of the rows, with units and meanings."""
    dtype: np.dtype[np.void]
    """NumPy type of a row."""
    topic: str
    """Topic of the rows, `/tick` or `/plant`."""
    can_channel: str
    """Name of the first bus."""
    can_channels: tuple[str, ...]
    """Name of each bus."""
    epoch_ns: int
    """UTC of t_ns = 0, ns."""
    lockstep: bool
    """True for simulated time, which starts at 2000-01-01."""

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        self.metadata, self.attachments = {}, {}
        self.cut, self._size = self._check_file()
        self._topics: dict[int, str] = {}
        with self._reading():
            for record in records(self.path, _MESSAGES, cut=bool(self.cut)):
                self._learn(record)
        identity = self.metadata.get(IDENTITY, {})
        if "dtype" in identity:
            raise LogError(f"{path}: {OLD}")
        if "columns" not in identity:
            reason = f"an MCAP file, but not a log of this product (no metadata record {IDENTITY!r})"
            raise LogError(f"{path}: {self.cut or reason}")
        try:
            run = Run.of(identity)
            row, frames = RowCodec(run.columns), frame_table([name.encode() for name in run.can_channels])
        except REFUSED as error:
            raise LogError(
                f"{path}: metadata record {IDENTITY!r} cannot be read: {why(error)}; {self._advice}"
            ) from None
        self.topic, self.epoch_ns, self.lockstep = run.topic, run.epoch_ns, run.lockstep
        self.columns, self.can_channels = completed(run.columns), run.can_channels
        self.can_channel, self.dtype = self.can_channels[0], Table(self.topic, self.columns).dtype
        self._row, self._frame = (row.layout, row.read), (self.epoch_ns, *frames)
        self._tick = row.read[row.dtype.fields["tick"][1] // 8]  # type: ignore[index]

    @property
    def _advice(self) -> str:
        """Advice in messages about damage: to salvage the log, unless it was salvaged before."""
        return SALVAGED if SALVAGE in self.metadata else ADVICE

    @property
    def configuration(self) -> str:
        """Text of the run's configuration.

        Raises LogError: the attachment is missing or not text.
        """
        if CONFIGURATION not in self.attachments:
            raise LogError(
                f"{self.path}: no attachment {CONFIGURATION}: the configuration of the run is not known"
            )
        try:
            return self.attachments[CONFIGURATION].decode()
        except UnicodeDecodeError as error:
            raise LogError(f"{self.path}: attachment {CONFIGURATION} is not text: {error}") from error

    def _check_file(self) -> tuple[str, int]:
        """Reason why the file is truncated ("" if complete), and its size, bytes; LogError if not MCAP."""
        with self._reading(), open_regular(self.path) as file:
            head, size = file.read(len(MAGIC)), file.seek(0, os.SEEK_END)
            file.seek(max(size - len(MAGIC), 0))
            tail = file.read()
        if not head or not MAGIC.startswith(head):
            raise LogError(f"{self.path}: {'not an MCAP file' if head else 'the file is empty'}")
        if size < len(MAGIC) + _FOOTER or tail != MAGIC:
            return (
                f"cut at {size} bytes, the end is missing (power loss, the recorder was killed, or the run "
                "is not over): run `hil replay --salvage` on it to recover what is there"
            ), size
        return "", size

    @contextmanager
    def _reading(self) -> Iterator[None]:
        """Context that adds the file name, and advice about damage, to errors of reading the file."""
        try:
            yield
        except LogError as error:
            advice = f"; {self._advice}" if isinstance(error, DamageError) else ""
            raise LogError(f"{self.path}: {error}{advice}") from None
        except FileNotFoundError:
            raise LogError(f"{self.path}: no such file") from None
        except OSError as error:
            raise LogError(f"{self.path}: cannot be read: {error.strerror}") from error

    def _learn(self, record: Record) -> None:
        """Store a complete metadata, attachment or channel record; of two with one name the first counts."""
        found: Any = record.parse() if record.complete else None
        match type(found).__name__:
            case "Metadata":
                self.metadata.setdefault(found.name, dict(found.metadata))
            case "Attachment":
                self.attachments.setdefault(found.name, bytes(found.data))
            case "Channel":
                self._topics[found.id] = found.topic

    def _decoded(self, *decode: Callable[[bytes, MessageTable], Any]) -> Iterator[list[Any]]:
        """Yield the results of decoders for each chunk; for a truncated chunk, only of its complete ticks.

        Raises LogError: damaged file, or messages out of the recorder's order.
        """
        with self._reading():
            allowance, last = Allowance(self._size), -1
            for record in records(self.path, cut=bool(self.cut)):
                if record.opcode == Opcode.MESSAGE:
                    raise record.damaged("a message outside a chunk, which no recorder writes")
                if record.opcode != Opcode.CHUNK:
                    continue
                data, table, channels = messages_in(record, allowance)
                for channel in channels:
                    self._topics[channel.id] = channel.topic
                if not record.complete:
                    table = table.before(self._messages_of(table, self.topic))
                last = self._require_order(data, table, last)
                yield [each(data, table) for each in decode]

    def _messages_of(self, table: MessageTable, topic: str) -> NDArray[np.intp]:
        """Indices of the messages of a topic in the table of a chunk."""
        wanted = np.zeros(1 << 16, np.bool_)
        wanted[[number for number, each in self._topics.items() if each == topic]] = True
        return np.flatnonzero(wanted[table.channel])

    def counted(self) -> int | None:
        """Number of rows according to the index at the end of the file; None without statistics.

        Raises LogError: the index is damaged.
        """
        with self._reading(), open_regular(self.path) as file:
            footer = record_at(file, self._size - _FOOTER)
            at = int.from_bytes(footer.content[:8], "little")  # 0: no index
            while 0 < at < footer.offset:
                record = record_at(file, at)
                if not record.complete:
                    raise record.damaged("no record in the index")
                if record.opcode == Opcode.STATISTICS:
                    counts: dict[int, int] = record.parse().channel_message_counts
                    return sum(counts.get(n, 0) for n, topic in self._topics.items() if topic == self.topic)
                at = record.end
        return None

    def _require_order(self, data: bytes, table: MessageTable, last: int) -> int:
        """Check the order of a chunk's messages; the result is the tick of its last row.

        A recorder writes the row of a tick first, then its frames and commands.

        last: tick of the previous chunk's last row.

        Raises LogError: ticks do not increase, or a frame or command does not follow its row.
        """
        rows = self._messages_of(table, self.topic)
        if (table.length[rows] != len(self._row[0].template)).any():
            raise _other(self.topic, _OTHER_LAYOUT)
        ticks = np.concatenate(([last], words_of(data)[table.offset[rows] + self._tick]))
        wrong = [np.diff(ticks) <= 0, ticks[1:] & _SEQUENCE != table.sequence[rows]]
        for topic in (CAN_TOPIC, OPERATOR_TOPIC):
            mine = self._messages_of(table, topic)
            own = ticks[np.searchsorted(rows, mine)]
            wrong.append(own & _SEQUENCE != table.sequence[mine])
        if any(each.any() for each in wrong):
            raise LogError(
                f"its messages are not in the order of a recorder, near tick {max(ticks[-1], 0)}: another "
                "program has sorted or changed them"
            )
        return int(ticks[-1])

    def _messages(self, data: bytes, table: MessageTable, topic: str) -> Iterator[Any]:
        """Yield the protobuf messages of a topic, operator commands or events, in a chunk."""
        for i in self._messages_of(table, topic).tolist():
            start, stop = int(table.offset[i]) + RECORD_HEADER, int(table.offset[i] + table.length[i])
            try:
                yield _CLASSES[topic].FromString(data[start:stop])
            except REFUSED as error:
                raise _other(topic, why(error)) from None

    def _events_in(self, data: bytes, table: MessageTable) -> list[Event]:
        """Events in a chunk."""
        found = []
        for message in self._messages(data, table, EVENTS_TOPIC):
            t_ns = message.timestamp.seconds * 1_000_000_000 + message.timestamp.nanos - self.epoch_ns
            found.append(Event(t_ns, LEVEL_NAMES.get(message.level, "info"), message.message))
        return found

    def _commands_in(self, data: bytes, table: MessageTable) -> list[Command]:
        """Operator commands in a chunk."""
        found = []
        for message in self._messages(data, table, OPERATOR_TOPIC):
            if message.command not in _OPERATORS:
                raise _other(OPERATOR_TOPIC, f"there is no command {message.command}")
            operator, numbers = Operator(message.command), tuple(message.setpoint)
            if len(numbers) != NUMBERS.get(operator, len(numbers)):
                raise LogError(
                    f"the operator's command of tick {message.tick} has {len(numbers)} numbers, "
                    f"allowed: {NUMBERS[operator]}"
                )
            found.append(Command(message.tick, message.index, operator, numbers))
        return found

    def _rows_in(self, data: bytes, table: MessageTable) -> Rows:
        """Rows of a chunk, in the order of the chunk, of dtype `self.dtype`."""
        mine = self._messages_of(table, self.topic)
        matrix = np.full((len(mine), self.dtype.itemsize // 8), np.nan).view(np.int64)
        if not unpack_rows(data, table.offset[mine], *self._row, matrix):
            raise _other(self.topic, _OTHER_LAYOUT)
        return matrix.view(self.dtype)[:, 0]

    def _frames_in(self, data: bytes, table: MessageTable) -> Rows:
        """CAN frames of a chunk, in the order of the chunk, as elements of ITEM."""
        mine = self._messages_of(table, CAN_TOPIC)
        items = np.zeros(len(mine), ITEM)
        good = unpack_frames(data, table.offset[mine], table.length[mine], *self._frame, items)
        if not good or (items["tick"] & _SEQUENCE != table.sequence[mine]).any():
            raise _other(CAN_TOPIC, _OTHER_LAYOUT)
        return items

    @cached_property
    def origin_ns(self) -> int:
        """`t_ns` of the first row, at which the times `t_s` of `Log.frame` begin; 0 without rows."""
        return next((int(block["t_ns"][0]) for block in self.blocks("t_ns")), 0)

    def rows(self, *names: str, start_s: float | None = None, stop_s: float | None = None) -> Rows:
        """Rows in tick order: a structured array (n,); ``rows["tau"]`` is (n, 6).

        names: columns; by default all.
        start_s, stop_s: first and last time, s from the first row.

        Raises LogError: unknown column, or damaged file.
        """
        found = np.zeros(0, self._chosen(names))
        return together((found, *self.blocks(*names, start_s=start_s, stop_s=stop_s)))

    def blocks(
        self, *names: str, start_s: float | None = None, stop_s: float | None = None
    ) -> Iterator[Rows]:
        """Yield what `rows` returns, block by block, for logs larger than memory.

        Raises LogError: as `rows`.
        """
        dtype, first_ns, last_ns = self._chosen(names), -np.inf, np.inf
        if start_s is not None:
            first_ns = self.origin_ns + start_s * 1e9
        if stop_s is not None:
            last_ns = self.origin_ns + stop_s * 1e9
        for (rows,) in self._decoded(self._rows_in):
            t = rows["t_ns"]
            inside = np.flatnonzero((t >= first_ns) & (t <= last_ns))
            chosen = rows if len(inside) == len(rows) else rows.take(inside)
            if len(inside):
                yield chosen if chosen.dtype == dtype else chosen[list(dtype.names or ())].astype(dtype)

    def _chosen(self, names: Sequence[str]) -> np.dtype[np.void]:
        """NumPy type of rows with the columns `names`, by default all. Raises LogError: unknown column."""
        there = {c.name: c for c in self.columns}
        unknown = [name for name in names if name not in there]
        if unknown:
            raise LogError(f"{self.path}: {no_column(unknown[0], tuple(there))}")
        chosen = [there[name] for name in dict.fromkeys(names or there)]
        return np.dtype([(c.name, c.kind, c.shape) for c in chosen])


def _other(topic: str, what: str) -> LogError:
    return LogError(f"a message of {topic} is damaged or of another kind: {what}")
