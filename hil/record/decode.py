"""From the messages of a log back to rows and frames.

Messages as our recorder writes them are taken apart in whole batches; those of another layout (a file that
went through another MCAP writer) by protobuf, with the same result.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from google.protobuf.message import DecodeError
from mcap.records import Channel
from mcap.records import Schema as SchemaRecord
from numpy.typing import NDArray

from drivers.arrays import Rows
from drivers.errors import LogError
from drivers.protocol import BRS, ERROR, ESI, EXTENDED, FD, REMOTE
from hil.record.mcap_read import MessageTable
from hil.record.schema import (
    MAX_DATA,
    RECORD_HEADER,
    Schema,
    frame_layout,
    message_class,
    row_layout,
    unpack_varint5,
)

CAN, OPERATOR, EVENTS = "/can", "/operator", "/events"
ITEM = np.dtype(
    [
        ("tick", "<i8"),
        ("index", "<u4"),
        ("direction", "u1"),
        ("flags", "u1"),
        ("length", "u1"),
        ("spare", "u1"),
        ("t_ns", "<i8"),
        ("id", "<u4"),
        ("data", "u1", (MAX_DATA,)),
    ]
)
_FLAGS = {"is_rtr": REMOTE, "is_extended": EXTENDED, "is_error": ERROR, "fdf": FD, "brs": BRS, "esi": ESI}


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

    def expect(self, topic: str, dtype: np.dtype[np.void], can_channel: str, epoch_ns: int) -> None:
        """Set the topic and type of the rows, the name of the bus and the UTC of t_ns = 0."""
        self._topic = topic
        self._dtype = dtype
        self._bus = can_channel.encode()
        self._epoch = epoch_ns
        self._row_layout = row_layout(dtype)

    def _of(self, table: MessageTable, topic: str) -> NDArray[np.intp]:
        """Return which messages of a table are of a topic."""
        ids = [i for i, channel in self._channels.items() if channel.topic == topic]
        return np.flatnonzero(np.isin(table.channel, ids))

    def messages(self, data: bytes, table: MessageTable, topic: str) -> Iterator[Any]:
        """Yield the messages of a topic, parsed by protobuf."""
        for i in self._of(table, topic).tolist():
            yield self._protobuf(data, table, i)

    def _protobuf(self, data: bytes, table: MessageTable, i: int) -> Any:
        channel = int(table.channel[i])
        start = int(table.offset[i])
        payload = data[start + RECORD_HEADER : start + int(table.length[i])]
        try:
            if channel not in self._classes:
                self._classes[channel] = message_class(self._schemas[self._channels[channel].schema_id])
            return self._classes[channel].FromString(payload)
        except (DecodeError, KeyError, TypeError) as error:
            raise LogError(
                f"{self._name}: a message of {self._channels[channel].topic} is damaged: {error}"
            ) from error

    def rows(self, data: bytes, table: MessageTable) -> Rows:
        """Return the rows in a buffer, in its order."""
        mine = self._of(table, self._topic)
        rows = np.zeros(len(mine), self._dtype)
        if not len(mine):
            return rows
        size = self._row_layout.template.size
        if (table.length[mine] == size).all():
            starts = (table.offset[mine] + RECORD_HEADER).tolist()
            stops = (table.offset[mine] + size).tolist()
            joined = b"".join([data[a:b] for a, b in zip(starts, stops, strict=True)])
            payloads = np.frombuffer(joined, np.uint8).reshape(len(mine), -1)
            if self._row_layout.fits(payloads):
                columns = payloads.view(self._row_layout.payload).reshape(len(mine))
                for name in self._dtype.names or ():
                    rows[name] = columns[name]
                return rows
        for n, i in enumerate(mine.tolist()):
            message = self._protobuf(data, table, i)
            for name in self._dtype.names or ():
                value = getattr(message, name)
                try:
                    rows[n][name] = value
                except (TypeError, ValueError) as error:
                    raise LogError(
                        f"{self._name}: column {name} of a row has another shape: {error}"
                    ) from error
        return rows

    def frames(self, data: bytes, table: MessageTable) -> Rows:
        """Return the frames in a buffer as elements of ITEM, in its order."""
        mine = self._of(table, CAN)
        items = np.zeros(len(mine), ITEM)
        buffer = np.frombuffer(data, np.uint8)
        shortest = frame_layout(0, self._bus).payload.itemsize
        sizes = table.length[mine] - RECORD_HEADER
        for size in np.unique(sizes).tolist():
            at = np.flatnonzero(sizes == size)
            length = size - shortest
            if 0 <= length <= MAX_DATA:
                layout = frame_layout(length, self._bus)
                starts = table.offset[mine[at]] + RECORD_HEADER
                payloads = buffer[starts[:, None] + np.arange(size)]
                if layout.fits(payloads):
                    items[at] = self._unpack(payloads.view(layout.payload).reshape(len(at)), length)
                    continue
            for i in at.tolist():
                items[i] = self._convert(self._protobuf(data, table, int(mine[i])))
        return items

    def _unpack(self, frames: Rows, length: int) -> Rows:
        items = np.zeros(len(frames), ITEM)
        seconds, nanos = unpack_varint5(frames["seconds"]), unpack_varint5(frames["nanos"])
        items["t_ns"] = seconds * 1_000_000_000 + nanos - self._epoch
        for name in ("tick", "index", "direction", "id"):
            items[name] = frames[name]
        for name, bit in _FLAGS.items():
            items["flags"] |= frames[name] * np.uint8(bit)
        items["length"] = length
        if length:
            items["data"][:, :length] = frames["data"]
        return items

    def _convert(self, message: Any) -> Rows:
        """Return the same from a parsed message."""
        item = np.zeros((), ITEM)
        stamp = message.header.stamp
        item["t_ns"] = stamp.seconds * 1_000_000_000 + stamp.nanos - self._epoch
        for name in ("tick", "index", "direction", "id"):
            item[name] = getattr(message, name)
        item["flags"] = sum(bit for name, bit in _FLAGS.items() if getattr(message, name))
        length = len(message.data)
        if length > MAX_DATA:
            raise LogError(f"{self._name}: a frame with {length} data bytes: at most {MAX_DATA}")
        item["length"] = length
        item["data"][:length] = np.frombuffer(message.data, np.uint8)
        return item
