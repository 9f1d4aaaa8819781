"""The container of a log: what stands beside its messages, and its messages decoded, chunk by chunk."""

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
from hil.record.layout import RECORD_HEADER, frame_table
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
from hil.record.unpack import ITEM, unpack_frames, unpack_rows, words_of
from hil.signals import NUMBERS, Operator

_MESSAGES = frozenset({Opcode.MESSAGE, Opcode.CHUNK, Opcode.MESSAGE_INDEX})
_FOOTER = 9 + 20 + len(MAGIC)
_CLASSES = {OPERATOR_TOPIC: message_class(operator_schema()), EVENTS_TOPIC: LogMessage}
_OPERATORS = frozenset(map(int, Operator))
_SEQUENCE = 0xFFFFFFFF
"""A message has this part of its tick in its head."""
_OTHER_LAYOUT = "its layout is not that of the recorder"
MEND, SALVAGED = "run `hil replay --salvage` on it", "it was salvaged before, and no more can be had of it"
"""What to do about a damaged log."""


class LogFile:
    """A log's file. State: metadata, attachments, channels met so far.

    Raises LogError: no such file, no MCAP, damaged, not written by this product, or cut within its first
    bytes.
    """

    path: Path
    metadata: dict[str, dict[str, str]]
    """Records by name, `hil` (the run), `environment` (the machine) and `summary` (its end) among them."""
    attachments: dict[str, bytes]
    """Files by name, those of the configuration, the protocol's database and what else replay needs."""
    cut: str
    """Why the file ends too early; empty for a whole one."""
    columns: tuple[Column, ...]
    """Of the rows."""
    dtype: np.dtype[np.void]
    """Type of the rows."""
    topic: str
    """Topic of the rows, `/tick` or `/plant`."""
    can_channel: str
    """Name of the bus; of several, of the first."""
    can_channels: tuple[str, ...]
    """Name of each bus."""
    epoch_ns: int
    """UTC of t_ns = 0."""
    lockstep: bool
    """Whether its time is simulated; it counts from 2000-01-01 then."""

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
                f"{path}: metadata record {IDENTITY!r} cannot be read: {why(error)}; {self._mend}"
            ) from None
        self.topic, self.epoch_ns, self.lockstep = run.topic, run.epoch_ns, run.lockstep
        self.columns, self.can_channels = completed(run.columns), run.can_channels
        self.can_channel, self.dtype = self.can_channels[0], Table(self.topic, self.columns).dtype
        self._row, self._frame = (row.layout, row.read), (self.epoch_ns, *frames)
        self._tick = row.read[row.dtype.fields["tick"][1] // 8]  # type: ignore[index]

    @property
    def _mend(self) -> str:
        """What may be done about damage: salvage, once."""
        return SALVAGED if SALVAGE in self.metadata else MEND

    @property
    def configuration(self) -> str:
        """Text of the configuration of the run.

        Raises LogError: the log has none, or one that is no text.
        """
        if CONFIGURATION not in self.attachments:
            raise LogError(
                f"{self.path}: no attachment {CONFIGURATION}: the configuration of the run is not known"
            )
        try:
            return self.attachments[CONFIGURATION].decode()
        except UnicodeDecodeError as error:
            raise LogError(f"{self.path}: attachment {CONFIGURATION} is no text: {error}") from error

    def _check_file(self) -> tuple[str, int]:
        """Return why the file is cut, or nothing, and its bytes; refuse what is no log at all."""
        with self._reading(), open_regular(self.path) as file:
            head, size = file.read(len(MAGIC)), file.seek(0, os.SEEK_END)
            file.seek(max(size - len(MAGIC), 0))
            tail = file.read()
        if not head or not MAGIC.startswith(head):
            raise LogError(f"{self.path}: {'not an MCAP file' if head else 'the file is empty'}")
        if size < len(MAGIC) + _FOOTER or tail != MAGIC:
            return (
                f"cut at {size} bytes, the end is missing (power loss, the recorder was killed, or the run "
                "goes on): run `hil replay --salvage` on it to recover what is there"
            ), size
        return "", size

    @contextmanager
    def _reading(self) -> Iterator[None]:
        """Name the file in what goes wrong while it is read, and what may be done about damage."""
        try:
            yield
        except LogError as error:
            mend = f"; {self._mend}" if isinstance(error, DamageError) else ""
            raise LogError(f"{self.path}: {error}{mend}") from None
        except FileNotFoundError:
            raise LogError(f"{self.path}: no such file") from None
        except OSError as error:
            raise LogError(f"{self.path}: cannot be read: {error.strerror}") from error

    def _learn(self, record: Record) -> None:
        """Keep what is whole and not a message; of two of one name the first, which is the recorder's."""
        found: Any = record.parse() if record.complete else None
        match type(found).__name__:
            case "Metadata":
                self.metadata.setdefault(found.name, dict(found.metadata))
            case "Attachment":
                self.attachments.setdefault(found.name, bytes(found.data))
            case "Channel":
                self._topics[found.id] = found.topic

    def _decoded(self, *decode: Callable[[bytes, MessageTable], Any]) -> Iterator[list[Any]]:
        """Yield what functions make of the messages of each chunk; of one that is cut, of its whole ticks.

        Raises LogError where the file is damaged, or its messages are not in the order of a recorder.
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
        """Return which messages of a table are of a topic."""
        wanted = np.zeros(1 << 16, np.bool_)
        wanted[[number for number, each in self._topics.items() if each == topic]] = True
        return np.flatnonzero(wanted[table.channel])

    def counted(self) -> int | None:
        """Rows that the index at the end of the file counts; None where it has no statistics.

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
        """Return the tick of the last row of a buffer; `last` is that of the one before.

        A recorder writes a tick as its row and behind it its frames and commands.

        Raises LogError: rows are not in the order of their ticks, or something stands elsewhere than behind
        its row.
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
        """Yield the commands or events in a buffer."""
        for i in self._messages_of(table, topic).tolist():
            start, stop = int(table.offset[i]) + RECORD_HEADER, int(table.offset[i] + table.length[i])
            try:
                yield _CLASSES[topic].FromString(data[start:stop])
            except REFUSED as error:
                raise _other(topic, why(error)) from None

    def _events_in(self, data: bytes, table: MessageTable) -> list[Event]:
        """Return the events in a buffer."""
        found = []
        for message in self._messages(data, table, EVENTS_TOPIC):
            t_ns = message.timestamp.seconds * 1_000_000_000 + message.timestamp.nanos - self.epoch_ns
            found.append(Event(t_ns, LEVEL_NAMES.get(message.level, "info"), message.message))
        return found

    def _commands_in(self, data: bytes, table: MessageTable) -> list[Command]:
        """Return the operator's commands in a buffer."""
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
        """Return the rows in a buffer, in its order."""
        mine = self._messages_of(table, self.topic)
        matrix = np.full((len(mine), self.dtype.itemsize // 8), np.nan).view(np.int64)
        if not unpack_rows(data, table.offset[mine], *self._row, matrix):
            raise _other(self.topic, _OTHER_LAYOUT)
        return matrix.view(self.dtype)[:, 0]

    def _frames_in(self, data: bytes, table: MessageTable) -> Rows:
        """Return the frames in a buffer as elements of ITEM, in its order."""
        mine = self._messages_of(table, CAN_TOPIC)
        items = np.zeros(len(mine), ITEM)
        good = unpack_frames(data, table.offset[mine], table.length[mine], *self._frame, items)
        if not good or (items["tick"] & _SEQUENCE != table.sequence[mine]).any():
            raise _other(CAN_TOPIC, _OTHER_LAYOUT)
        return items

    @cached_property
    def origin_ns(self) -> int:
        """Where the time `t_s` of a frame begins, the `t_ns` of the first row; 0 without a row."""
        return next((int(block["t_ns"][0]) for block in self.blocks("t_ns")), 0)

    def rows(self, *names: str, start_s: float | None = None, stop_s: float | None = None) -> Rows:
        """Return rows in tick order: a structured array (n,), ``rows["tau"]`` is (n, 6).

        names: columns to read; all where none is given.
        start_s, stop_s: first and last time, s from the first row.

        Raises LogError: no such column, or the file is damaged.
        """
        found = np.zeros(0, self._chosen(names))
        return together((found, *self.blocks(*names, start_s=start_s, stop_s=stop_s)))

    def blocks(
        self, *names: str, start_s: float | None = None, stop_s: float | None = None
    ) -> Iterator[Rows]:
        """Yield what `rows` returns in pieces, reading as it goes: for logs that do not fit into memory.

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
        """Return the type of rows of the columns named, of all without a name. Raises LogError."""
        there = {c.name: c for c in self.columns}
        unknown = [name for name in names if name not in there]
        if unknown:
            raise LogError(f"{self.path}: {no_column(unknown[0], tuple(there))}")
        chosen = [there[name] for name in dict.fromkeys(names or there)]
        return np.dtype([(c.name, c.kind, c.shape) for c in chosen])


def _other(topic: str, what: str) -> LogError:
    return LogError(f"a message of {topic} is damaged or of another kind: {what}")
