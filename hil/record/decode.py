"""From the messages of a log back to rows and frames.

Messages as our recorder writes them are taken apart in whole batches; those of another layout (a file that
went through another MCAP writer) by protobuf, with the same result.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import cached_property
from typing import Any

import numpy as np
from google.protobuf.message import DecodeError
from mcap.records import Channel
from mcap.records import Schema as SchemaRecord
from numpy.typing import NDArray

from drivers.arrays import Rows
from drivers.errors import LogError
from drivers.tick_columns import Column
from hil.record import ring
from hil.record.layout import FRAME_FLAGS, MAX_DATA, RECORD_HEADER
from hil.record.mcap_read import MessageTable
from hil.record.row import RowCodec
from hil.record.schema import Schema, message_class
from hil.record.unpack import ITEM_WORDS, Kernels, constants_of, frame_table, kernels_for, words_of

CAN, OPERATOR, EVENTS = "/can", "/operator", "/events"
ITEM = np.dtype(
    [("direction" if name == "kind" else name, *rest) for name, *rest in ring.ITEM.descr]
    + [("tick", "<i8"), ("index", "<i8")]
)
"""A frame as the recorder has it, with its direction in place of its kind, and its place."""
REFUSED = (AttributeError, DecodeError, KeyError, OverflowError, RecursionError, TypeError, ValueError)
"""What protobuf, NumPy and Python raise of schemas, tables and messages of unknown making."""
_NUMBERS = ("tick", "index", "direction", "id", "bus")
_GROWTH, _FREE = 8, 1 << 20
"""Rows may take so many times the bytes of their messages, and so many bytes more: zeros may be left out."""


def why(error: Exception) -> str:
    """Say in words what was met in data of unknown making; REFUSED are what it raises."""
    if isinstance(error, KeyError):
        return f"it has no {error.args[0]!r}" if error.args else "something is missing"
    return str(error) or type(error).__name__


class Decoder:
    """Decodes the messages of one log. State: the schemas and channels met so far, and what to expect."""

    def __init__(self, name: str, log_bytes: int = 0) -> None:
        self._name = name
        self._log_bytes = log_bytes
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._classes: dict[int, Any] = {}

    def learn(self, record: SchemaRecord | Channel) -> None:
        """Take note of a schema or channel."""
        if isinstance(record, Channel):
            self._channels[record.id] = record
        else:
            self._schemas[record.id] = Schema(record.name, bytes(record.data))

    def expect(
        self, topic: str, columns: Sequence[Column], can_channels: Sequence[str], epoch_ns: int
    ) -> None:
        """Set the topic and columns of the rows, the names of the buses and the UTC of t_ns = 0."""
        self._topic = topic
        self._frame = frame_table([name.encode() for name in can_channels])
        self._epoch = epoch_ns
        self._row = RowCodec(columns)
        layout = self._row.layout
        constants = constants_of(layout.template[RECORD_HEADER:], layout.mask())
        self._row_table = constants, self._row.places()

    @cached_property
    def kernels(self) -> Kernels:
        """What takes the buffers of this log apart."""
        return kernels_for(self._log_bytes)

    def messages_of(self, table: MessageTable, topic: str) -> NDArray[np.intp]:
        """Return which messages of a table are of a topic."""
        found = np.zeros(len(table.channel), np.bool_)
        for number, channel in self._channels.items():
            if channel.topic == topic:
                found |= table.channel == number
        return np.flatnonzero(found)

    def messages(self, data: bytes, table: MessageTable, topic: str) -> Iterator[Any]:
        """Yield the messages of a topic, parsed by protobuf."""
        for i in self.messages_of(table, topic).tolist():
            yield self._protobuf(data, table, i)

    def _protobuf(self, data: bytes, table: MessageTable, i: int) -> Any:
        channel = int(table.channel[i])
        start = int(table.offset[i])
        payload = data[start + RECORD_HEADER : start + int(table.length[i])]
        with self.understood(self._channels[channel].topic):
            if channel not in self._classes:
                self._classes[channel] = message_class(self._schemas[self._channels[channel].schema_id])
            return self._classes[channel].FromString(payload)

    @contextmanager
    def understood(self, topic: str) -> Iterator[None]:
        """Turn what a message or schema of unknown making can raise into a LogError."""
        try:
            yield
        except REFUSED as error:
            raise LogError(
                f"{self._name}: a message of {topic} is damaged or of another kind: {why(error)}"
            ) from None

    def rows(self, data: bytes, table: MessageTable) -> Rows:
        """Return the rows in a buffer, in its order."""
        mine = self.messages_of(table, self._topic)
        words = self._row.dtype.itemsize // 8
        if (table.length[mine] == self._row.layout.template.size).all():
            rows = np.empty(len(mine), self._row.dtype)
            starts, matrix = table.offset[mine] + RECORD_HEADER, rows.view(np.int64).reshape(-1, words)
            if self.kernels.rows(words_of(data), starts, *self._row_table, matrix):
                return rows
        taken = int(table.length[mine].sum())
        if len(mine) * self._row.dtype.itemsize > _GROWTH * taken + _FREE:
            raise LogError(
                f"{self._name}: {len(mine)} messages of {self._topic} of {taken} bytes together are too "
                f"short for rows of {self._row.dtype.itemsize} bytes"
            )
        rows = np.zeros(len(mine), self._row.dtype)
        with self.understood(self._topic):
            for n, i in enumerate(mine.tolist()):
                rows[n] = self._row.parse(self._protobuf(data, table, i))
        return rows

    def frames(self, data: bytes, table: MessageTable) -> Rows:
        """Return the frames in a buffer as elements of ITEM, in its order."""
        mine = self.messages_of(table, CAN)
        items, fit = np.zeros(len(mine), ITEM), np.zeros(len(mine), np.bool_)
        where = table.offset[mine] + RECORD_HEADER, table.length[mine] - RECORD_HEADER
        matrix = items.view(np.int64).reshape(len(mine), ITEM_WORDS)
        with np.errstate(over="ignore"):  # of damaged times
            self.kernels.frames(words_of(data), *where, self._epoch, *self._frame, matrix, fit)
        with self.understood(CAN):
            for i in np.flatnonzero(~fit).tolist():
                items[i] = self._convert(self._protobuf(data, table, int(mine[i])))
        return items

    def _convert(self, message: Any) -> Rows:
        """Return the same from a parsed message."""
        item = np.zeros((), ITEM)
        stamp = message.header.stamp
        item["t_ns"] = stamp.seconds * 1_000_000_000 + stamp.nanos - self._epoch
        for name in _NUMBERS:
            item[name] = getattr(message, name, 0)  # version 0.1.0 had no `bus`
        item["flags"] = sum(bit for name, bit in FRAME_FLAGS.items() if getattr(message, name))
        length = len(message.data)
        if length > MAX_DATA:
            raise LogError(f"{self._name}: a frame with {length} data bytes: at most {MAX_DATA}")
        item["length"] = length
        item["data"][:length] = np.frombuffer(message.data, np.uint8)
        return item
