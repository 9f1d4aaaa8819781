"""From a batch of ticks in the ring to MCAP messages as bytes."""

import struct
from bisect import bisect_left
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from google.protobuf.timestamp_pb2 import Timestamp
from mcap.opcode import Opcode
from mcap_protobuf.schema import build_file_descriptor_set

from drivers.arrays import Ints, Rows
from drivers.can.bus_time import FD_LENGTHS
from hil.record import layout
from hil.record.recording import VIEW_EVERY, Scene
from hil.record.ring import EVENT, OPERATOR, RECEIVED, SENT, Batch, unpack_numbers
from hil.record.row import RowCodec, Table, row_schema
from hil.record.scene import SceneDrawer, transforms
from hil.record.schema import RX, TX, Schema, frame_schema, message_class, operator_schema

TICK, CAN, COMMANDS, EVENTS, TF, SCENE = 1, 2, 3, 4, 5, 6
"""Channel ids."""
_LAST = 1 << 24
_MESSAGE = struct.Struct("<BQHIQQ")
"""Opcode, bytes that follow, channel, sequence, log and publish time, ns; then the message."""


class Messages(NamedTuple):
    """Complete MCAP Message records in file order, and what the index needs of them."""

    data: list[memoryview | bytes]
    channel: Ints
    log_time: Ints
    length: Ints
    tick: Ints
    """Position of the tick in the batch: chunks are cut between ticks."""


class _Block(NamedTuple):
    """Messages of one channel and one length."""

    key: Ints
    channel: int
    log_time: Ints
    data: list[memoryview | bytes]


class Encoder:
    """Turns batches into messages. State: the tick that comes next, for events between ticks."""

    def __init__(
        self,
        table: Table,
        *,
        epoch_ns: int,
        can_channel: str,
        scene: Scene | None,
        can_channels: Sequence[str] = (),
    ) -> None:
        """Take the columns, UTC of t_ns = 0, the bus's name, what is drawn, the names of several buses."""
        self._row = RowCodec(table.columns)
        self._epoch = epoch_ns
        self._buses = [name.encode() for name in can_channels or (can_channel,)]
        self._view_every = scene.every if scene else VIEW_EVERY
        self._drawer = SceneDrawer(scene) if scene else None
        self._operator = message_class(operator_schema())
        self._next_tick = 0
        self.channels: dict[int, tuple[str, Schema, dict[str, str]]] = {
            TICK: (table.topic, row_schema(table), {}),
            CAN: ("/can", frame_schema(), {"channel": ", ".join(can_channels) or can_channel}),
            COMMANDS: ("/operator", operator_schema(), {}),
            EVENTS: ("/events", _foxglove(Log), {}),
            TF: ("/tf", _foxglove(FrameTransform), {}),
            SCENE: ("/scene", _foxglove(SceneUpdate), {}),
        }

    def encode(self, batch: Batch) -> Messages:
        """Return the messages of a batch: per tick the row, its items in order, its views."""
        rows, items, position = batch
        count = len(rows)
        ticks = np.append(rows["tick"], rows["tick"][-1] + 1 if count else self._next_tick)
        times = np.append(rows["t_ns"], 0)
        self._next_tick = int(ticks[-1])
        index = np.arange(len(items)) - np.searchsorted(position, position)
        key = position * _LAST + 1 + index
        blocks = [self._rows(rows)] if count else []
        frames = items["kind"] <= SENT
        for length in np.unique(items["length"][frames]).tolist():
            of_length = np.flatnonzero(frames & (items["length"] == length))
            for bus, name in enumerate(self._buses):
                mine = of_length[np.minimum(items["bus"][of_length], len(self._buses) - 1) == bus]
                at = position[mine]
                data = items[mine], length, name
                blocks.append(self._frames(*data, ticks[at], times[at], index[mine], key[mine]))
        for i in np.flatnonzero(~frames).tolist():
            n = int(position[i])
            blocks.extend(self._rare(items, i, int(ticks[n]), int(times[n]), int(index[i]), key[i : i + 1]))
        for i in np.flatnonzero(rows["tick"] % self._view_every == 0).tolist():
            blocks.extend(self._views(rows[i], i * _LAST + _LAST - 3))
        return _in_order(blocks)

    def _rows(self, rows: Rows) -> _Block:
        records = self._row.layout.new(len(rows))
        self._row.write(rows, records)
        log_time = rows["t_ns"] + self._epoch
        return self._block(records, TICK, rows["tick"], log_time, log_time, np.arange(len(rows)) * _LAST)

    def _frames(
        self, items: Rows, length: int, bus: bytes, ticks: Ints, times: Ints, index: Ints, key: Ints
    ) -> _Block:
        records = layout.frame_layout(length, bus).new(len(items))
        log_time = items["t_ns"] + self._epoch
        seconds, nanos = np.divmod(log_time, 1_000_000_000)
        records["seconds"] = layout.pack_varint5(seconds)
        records["nanos"] = layout.pack_varint5(nanos)
        records["id"] = items["id"]
        flags = items["flags"]
        for name, bit in layout.FRAME_FLAGS.items():
            records[name] = (flags & bit) != 0
        records["dlc"] = bisect_left(FD_LENGTHS, length)  # code of ISO 11898-1
        if length:
            records["data"] = items["data"][:, :length]
        records["direction"] = np.where(items["kind"] == RECEIVED, RX, TX)
        records["tick"] = ticks
        records["index"] = index
        records["bus"] = items["bus"]
        return self._block(records, CAN, ticks, log_time, times + self._epoch, key)

    @staticmethod
    def _block(
        records: Rows, channel: int, ticks: Ints, log_time: Ints, publish_time: Ints, key: Ints
    ) -> _Block:
        records["@channel"] = channel
        records["@sequence"] = ticks & 0xFFFFFFFF
        records["@log_time"] = log_time
        records["@publish_time"] = publish_time
        size = records.itemsize
        data = memoryview(records.tobytes())
        return _Block(key, channel, log_time, [data[i : i + size] for i in range(0, len(data), size)])

    def _rare(self, items: Rows, i: int, tick: int, t_ns: int, index: int, key: Ints) -> list[_Block]:
        """Return the message of an operator command, or of an event at its last piece."""
        item = items[i]
        time_ns = int(item["t_ns"]) + self._epoch
        if item["kind"] == OPERATOR:
            data = bytes(item["data"][: item["length"]])
            numbers = unpack_numbers(data)
            message = self._operator(command=int(item["id"]), tick=tick, index=index, setpoint=numbers)
            message.stamp.seconds, message.stamp.nanos = divmod(time_ns, 1_000_000_000)
            return [_single(COMMANDS, tick, time_ns, t_ns + self._epoch, message, key)]
        if item["id"]:  # more pieces follow
            return []
        message = Log(
            timestamp=_stamp(time_ns),
            level=Log.Level.ValueType(int(item["flags"])),
            message=event_text(items, i),
            name="hil",
        )
        return [_single(EVENTS, tick, time_ns, time_ns, message, key)]

    def _views(self, row: Rows, key: int) -> list[_Block]:
        tick, time_ns = int(row["tick"]), int(row["t_ns"]) + self._epoch
        stamp = _stamp(time_ns)
        messages = [(TF, data) for data in transforms(row, stamp)]
        scene = self._drawer.update(row, stamp) if self._drawer else None
        if scene is not None:
            messages.append((SCENE, scene))
        return [
            _single(channel, tick, time_ns, time_ns, data, np.array([key + i]))
            for i, (channel, data) in enumerate(messages)
        ]


def event_text(items: Rows, i: int) -> str:
    """Return the text of the event whose last piece is item i."""
    first = i
    while first > 0 and items[first - 1]["kind"] == EVENT and items[first - 1]["id"] > 0:
        first -= 1
    data = b"".join(bytes(piece["data"][: piece["length"]]) for piece in items[first : i + 1])
    return data.decode(errors="replace")


def _stamp(time_ns: int) -> Timestamp:
    return Timestamp(seconds=time_ns // 1_000_000_000, nanos=time_ns % 1_000_000_000)


def _foxglove(message: Any) -> Schema:
    return Schema(
        message.DESCRIPTOR.full_name, build_file_descriptor_set(message).SerializeToString(deterministic=True)
    )


def _single(channel: int, tick: int, log_time: int, publish_time: int, message: Any, key: Ints) -> _Block:
    payload = message if isinstance(message, bytes) else message.SerializeToString(deterministic=True)
    size = layout.RECORD_HEADER - 9 + len(payload)
    head = _MESSAGE.pack(Opcode.MESSAGE, size, channel, tick & 0xFFFFFFFF, log_time, publish_time)
    return _Block(key, channel, np.array([log_time]), [head + payload])


def _in_order(blocks: list[_Block]) -> Messages:
    """Merge blocks by key."""
    if not blocks:
        none = np.zeros(0, np.int64)
        return Messages([], none, none, none, none)
    key = np.concatenate([block.key for block in blocks])
    order = np.argsort(key)
    data = [record for block in blocks for record in block.data]
    channel = np.repeat([block.channel for block in blocks], [len(block.key) for block in blocks])
    length = np.array([len(record) for record in data], np.int64)
    log_time = np.concatenate([block.log_time for block in blocks])
    return Messages(
        [data[i] for i in order.tolist()], channel[order], log_time[order], length[order], key[order] // _LAST
    )
