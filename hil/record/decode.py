"""From the messages of a log back to rows and frames.

Rows and frames are taken apart in whole batches, as our recorder lays them out; what another program has
encoded in another way is refused. Commands and events are read by protobuf.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import cached_property
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.Log_pb2 import Log
from google.protobuf.message import DecodeError
from mcap.records import Channel
from numpy.typing import NDArray

from drivers.arrays import Rows
from drivers.errors import LogError
from drivers.frame_array import FRAME
from drivers.tick_columns import Column
from hil.record.layout import RECORD_HEADER, frame_table
from hil.record.mcap_read import MessageTable
from hil.record.row import RowCodec
from hil.record.schema import CAN_TOPIC, EVENTS_TOPIC, OPERATOR_TOPIC, message_class, operator_schema
from hil.record.unpack import ITEM_WORDS, Kernels, constants_of, kernels_for, words_of

ITEM = np.dtype([("frame", FRAME), ("tick", "<i8"), ("index", "<i8")])
"""A frame as the recorder has it, and its place: its tick, and its number in it."""
REFUSED = (AttributeError, DecodeError, KeyError, OverflowError, RecursionError, TypeError, ValueError)
"""What protobuf, NumPy and Python raise of tables and messages of unknown making."""

_OTHER_LAYOUT = "its layout is not that of the recorder"


def why(error: Exception) -> str:
    """Say in words what was met in data of unknown making; REFUSED are what it raises."""
    if isinstance(error, KeyError):
        return f"it has no {error.args[0]!r}" if error.args else "something is missing"
    return str(error) or type(error).__name__


class Decoder:
    """Decodes the messages of one log. State: the channels met so far, and what to expect."""

    def __init__(self, name: str, log_bytes: int = 0) -> None:
        self._name = name
        self._log_bytes = log_bytes
        self._topics: dict[int, str] = {}
        self._classes = {OPERATOR_TOPIC: message_class(operator_schema()), EVENTS_TOPIC: Log}

    def learn(self, channel: Channel) -> None:
        """Take note of a channel."""
        self._topics[channel.id] = channel.topic

    def expect(
        self, topic: str, columns: Sequence[Column], can_channels: Sequence[str], epoch_ns: int
    ) -> None:
        """Set the topic and columns of the rows, the names of the buses and the UTC of t_ns = 0."""
        self._topic = topic
        frames, table = frame_table([name.encode() for name in can_channels])
        self._frame = epoch_ns, *constants_of(frames), table
        row = RowCodec(columns)
        self.dtype, self._size = row.dtype, row.layout.template.size
        self._row = *constants_of(row.layout), row.read

    @cached_property
    def kernels(self) -> Kernels:
        """What takes the buffers of this log apart."""
        return kernels_for(self._log_bytes)

    def messages_of(self, table: MessageTable, topic: str) -> NDArray[np.intp]:
        """Return which messages of a table are of a topic."""
        found = np.zeros(len(table.channel), np.bool_)
        for number, each in self._topics.items():
            if each == topic:
                found |= table.channel == number
        return np.flatnonzero(found)

    def messages(self, data: bytes, table: MessageTable, topic: str) -> Iterator[Any]:
        """Yield the commands or events in a buffer."""
        for i in self.messages_of(table, topic).tolist():
            start = int(table.offset[i])
            with self.understood(topic):
                yield self._classes[topic].FromString(
                    data[start + RECORD_HEADER : start + int(table.length[i])]
                )

    @contextmanager
    def understood(self, topic: str) -> Iterator[None]:
        """Turn what a message of unknown making can raise into a LogError."""
        try:
            yield
        except REFUSED as error:
            raise self._other(topic, why(error)) from None

    def _other(self, topic: str, what: str) -> LogError:
        return LogError(f"{self._name}: a message of {topic} is damaged or of another kind: {what}")

    def rows(self, data: bytes, table: MessageTable) -> Rows:
        """Return the rows in a buffer, in its order."""
        mine = self.messages_of(table, self._topic)
        if (table.length[mine] != self._size).any():
            raise self._other(self._topic, _OTHER_LAYOUT)
        rows = np.empty(len(mine), self.dtype)
        matrix = rows.view(np.int64).reshape(len(mine), self.dtype.itemsize // 8)
        if not self.kernels.rows(words_of(data), table.offset[mine], *self._row, matrix):
            raise self._other(self._topic, _OTHER_LAYOUT)
        return rows

    def frames(self, data: bytes, table: MessageTable) -> Rows:
        """Return the frames in a buffer as elements of ITEM, in its order."""
        mine = self.messages_of(table, CAN_TOPIC)
        items = np.zeros(len(mine), ITEM)
        matrix = items.view(np.int64).reshape(len(mine), ITEM_WORDS)
        with np.errstate(over="ignore"):  # of damaged times
            read = self.kernels.frames(
                words_of(data), table.offset[mine], table.length[mine], *self._frame, matrix
            )
        if read < len(mine):
            raise self._other(CAN_TOPIC, _OTHER_LAYOUT)
        return items
