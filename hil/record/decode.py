"""From the messages of a log back to rows and frames.

Messages as our recorder writes them are taken apart in whole batches; those of another layout (a file that
went through another MCAP writer) by protobuf, with the same result.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from google.protobuf.message import DecodeError
from mcap.records import Channel
from mcap.records import Schema as SchemaRecord
from numpy.typing import NDArray

from drivers.arrays import Rows
from drivers.errors import LogError
from drivers.tick_columns import Column
from hil.record.layout import FRAME_FLAGS, MAX_DATA, RECORD_HEADER, frame_layout, unpack_varint5
from hil.record.mcap_read import MessageTable
from hil.record.row import RowCodec
from hil.record.schema import Schema, message_class

CAN, OPERATOR, EVENTS = "/can", "/operator", "/events"
ITEM = np.dtype(
    [
        ("tick", "<i8"),
        ("index", "<u4"),
        ("direction", "u1"),
        ("flags", "u1"),
        ("length", "u1"),
        ("bus", "u1"),
        ("t_ns", "<i8"),
        ("id", "<u4"),
        ("data", "u1", (MAX_DATA,)),
    ]
)
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

    def __init__(self, name: str) -> None:
        self._name = name
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
        self._buses = [name.encode() for name in can_channels]
        self._epoch = epoch_ns
        self._row = RowCodec(columns)

    def messages_of(self, table: MessageTable, topic: str) -> NDArray[np.intp]:
        """Return which messages of a table are of a topic."""
        ids = [i for i, channel in self._channels.items() if channel.topic == topic]
        return np.flatnonzero(np.isin(table.channel, ids))

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
        layout = self._row.layout
        size = layout.template.size
        if len(mine) and (table.length[mine] == size).all():
            starts = (table.offset[mine] + RECORD_HEADER).tolist()
            stops = (table.offset[mine] + size).tolist()
            joined = b"".join([data[a:b] for a, b in zip(starts, stops, strict=True)])
            payloads = np.frombuffer(joined, np.uint8).reshape(len(mine), -1)
            if layout.fits(payloads):
                return self._row.read(payloads.view(layout.payload).reshape(len(mine)))
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
        items = np.zeros(len(mine), ITEM)
        buffer = np.frombuffer(data, np.uint8)
        shortest = [(name, frame_layout(0, name).payload.itemsize) for name in self._buses]
        sizes = table.length[mine] - RECORD_HEADER
        for size in np.unique(sizes).tolist():
            at = np.flatnonzero(sizes == size)
            for name, least in shortest:
                length = size - least
                if 0 <= length <= MAX_DATA:
                    layout = frame_layout(length, name)
                    starts = table.offset[mine[at]] + RECORD_HEADER
                    payloads = buffer[starts[:, None] + np.arange(size)]
                    fit = layout.fitting(payloads)
                    known = np.ascontiguousarray(payloads[fit]).view(layout.payload).reshape(-1)
                    items[at[fit]] = self._unpack(known, length)
                    at = at[~fit]
            with self.understood(CAN):
                for i in at.tolist():
                    items[i] = self._convert(self._protobuf(data, table, int(mine[i])))
        return items

    def _unpack(self, frames: Rows, length: int) -> Rows:
        items = np.zeros(len(frames), ITEM)
        seconds, nanos = unpack_varint5(frames["seconds"]), unpack_varint5(frames["nanos"])
        items["t_ns"] = seconds * 1_000_000_000 + nanos - self._epoch
        for name in _NUMBERS:
            items[name] = frames[name]
        for name, bit in FRAME_FLAGS.items():
            items["flags"] |= (frames[name] != 0) * np.uint8(bit)
        items["length"] = length
        if length:
            items["data"][:, :length] = frames["data"]
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
