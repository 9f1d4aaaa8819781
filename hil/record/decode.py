"""From the messages of a log back to rows and frames.

Rows and frames are taken apart in whole batches, as our recorder lays them out; what another program has
encoded in another way is refused. Commands and events are read by protobuf.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.Log_pb2 import Log
from google.protobuf.message import DecodeError
from mcap.records import Channel
from numpy.typing import NDArray

from drivers.arrays import Rows
from drivers.errors import LogError
from hil.record.entries import Command, Event
from hil.record.layout import RECORD_HEADER, frame_table
from hil.record.mcap_read import MessageTable
from hil.record.row import RowCodec, Run, Table, completed
from hil.record.schema import (
    CAN_TOPIC,
    EVENTS_TOPIC,
    LEVEL_NAMES,
    OPERATOR_TOPIC,
    message_class,
    operator_schema,
)
from hil.record.unpack import ITEM, unpack_frames, unpack_rows, words_of
from hil.signals import NUMBERS, Operator

REFUSED = (AttributeError, DecodeError, KeyError, OverflowError, RecursionError, TypeError, ValueError)
"""What protobuf, NumPy and Python raise of tables and messages of unknown making."""

_OPERATORS = frozenset(map(int, Operator))
_SEQUENCE = 0xFFFFFFFF
"""A message has this part of its tick in its head."""
_OTHER_LAYOUT = "its layout is not that of the recorder"


def why(error: Exception) -> str:
    """Say in words what was met in data of unknown making; REFUSED are what it raises."""
    if isinstance(error, KeyError):
        return f"it has no {error.args[0]!r}" if error.args else "something is missing"
    return str(error) or type(error).__name__


class Decoder:
    """Decodes the messages of one log. State: the channels met so far, and what to expect."""

    def __init__(self) -> None:
        self._topics: dict[int, str] = {}
        self._classes = {OPERATOR_TOPIC: message_class(operator_schema()), EVENTS_TOPIC: Log}

    def learn(self, channel: Channel) -> None:
        """Take note of a channel."""
        self._topics[channel.id] = channel.topic

    def expect(self, run: Run) -> None:
        """Set what the log says of its rows and frames; columns of LATER that it lacks are nan."""
        self._topic = run.topic
        frames, table = frame_table([name.encode() for name in run.can_channels])
        self._frame = run.epoch_ns, frames, table
        row = RowCodec(run.columns)
        at = row.dtype.fields["tick"][1] // 8  # type: ignore[index]
        self._size, self._tick = len(row.layout.template), row.read[at]
        self._row = row.layout, row.read
        self.dtype = Table(run.topic, completed(run.columns)).dtype

    def messages_of(self, table: MessageTable, topic: str) -> NDArray[np.intp]:
        """Return which messages of a table are of a topic."""
        numbers = [number for number, each in self._topics.items() if each == topic]
        return np.flatnonzero(np.isin(table.channel, numbers))

    def require_order(self, data: bytes, table: MessageTable, last: int) -> int:
        """Return the tick of the last row of a buffer; `last` is that of the one before.

        A recorder writes a tick as its row and behind it its frames and commands.

        Raises
        ------
        LogError
            Rows are not in the order of their ticks, or something stands elsewhere than behind its row.

        """
        rows = self.messages_of(table, self._topic)
        if (table.length[rows] != self._size).any():
            raise _other(self._topic, _OTHER_LAYOUT)
        ticks = np.concatenate(([last], words_of(data)[table.offset[rows] + self._tick]))
        wrong = (np.diff(ticks) <= 0).any() or (ticks[1:] & _SEQUENCE != table.sequence[rows]).any()
        for topic in (CAN_TOPIC, OPERATOR_TOPIC):
            mine = self.messages_of(table, topic)
            own = ticks[np.searchsorted(rows, mine)]
            wrong |= (own & _SEQUENCE != table.sequence[mine]).any()
        if wrong:
            raise LogError(
                f"its messages are not in the order of a recorder, near tick {max(ticks[-1], 0)}: another "
                "program has sorted or changed them"
            )
        return int(ticks[-1])

    def counts(self, _: bytes, table: MessageTable) -> tuple[int, int]:
        """Return the rows and frames in a buffer."""
        return len(self.messages_of(table, self._topic)), len(self.messages_of(table, CAN_TOPIC))

    def _messages(self, data: bytes, table: MessageTable, topic: str) -> Iterator[Any]:
        """Yield the commands or events in a buffer."""
        for i in self.messages_of(table, topic).tolist():
            start, stop = int(table.offset[i]) + RECORD_HEADER, int(table.offset[i] + table.length[i])
            try:
                yield self._classes[topic].FromString(data[start:stop])
            except REFUSED as error:
                raise _other(topic, why(error)) from None

    def events(self, data: bytes, table: MessageTable) -> list[Event]:
        """Return the events in a buffer."""
        found = []
        for message in self._messages(data, table, EVENTS_TOPIC):
            t_ns = message.timestamp.seconds * 1_000_000_000 + message.timestamp.nanos - self._frame[0]
            found.append(Event(t_ns, LEVEL_NAMES.get(message.level, "info"), message.message))
        return found

    def commands(self, data: bytes, table: MessageTable) -> list[Command]:
        """Return the operator's commands in a buffer."""
        found = []
        for message in self._messages(data, table, OPERATOR_TOPIC):
            each = Command(message.tick, message.index, message.command, tuple(message.setpoint))
            if each.operator not in _OPERATORS:
                raise _other(OPERATOR_TOPIC, f"there is no command {each.operator}")
            wanted = NUMBERS.get(each.operator, len(each.numbers))
            if len(each.numbers) != wanted:
                raise LogError(
                    f"the operator's command of tick {each.tick} has {len(each.numbers)} numbers, "
                    f"allowed: {wanted}"
                )
            found.append(each)
        return found

    def rows(self, data: bytes, table: MessageTable) -> Rows:
        """Return the rows in a buffer, in its order."""
        mine = self.messages_of(table, self._topic)
        matrix = np.full((len(mine), self.dtype.itemsize // 8), np.nan).view(np.int64)
        if not unpack_rows(data, table.offset[mine], *self._row, matrix):
            raise _other(self._topic, _OTHER_LAYOUT)
        return matrix.view(self.dtype)[:, 0]

    def frames(self, data: bytes, table: MessageTable) -> Rows:
        """Return the frames in a buffer as elements of ITEM, in its order."""
        mine = self.messages_of(table, CAN_TOPIC)
        items, where = np.zeros(len(mine), ITEM), (table.offset[mine], table.length[mine])
        good = unpack_frames(data, *where, *self._frame, items)
        if not good or (items["tick"] & _SEQUENCE != table.sequence[mine]).any():
            raise _other(CAN_TOPIC, _OTHER_LAYOUT)
        return items


def _other(topic: str, what: str) -> LogError:
    return LogError(f"a message of {topic} is damaged or of another kind: {what}")
