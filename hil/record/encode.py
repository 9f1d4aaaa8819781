"""Encodes a batch of ticks from the ring as the bytes of MCAP messages."""

import struct
from collections.abc import Callable, Iterator, Sequence
from functools import cached_property
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from google.protobuf.timestamp_pb2 import Timestamp
from mcap.opcode import Opcode

from drivers.arrays import Bytes, Ints, Rows
from hil.record.child import loaded
from hil.record.layout import MAX_DATA, RECORD_HEADER, frame_table
from hil.record.recording import VIEW_EVERY, Scene
from hil.record.ring import EVENT, OPERATOR, SENT, Batch, unpack_numbers
from hil.record.row import RowCodec, Table, row_schema
from hil.record.scene import SceneDrawer, transforms
from hil.record.schema import (
    CAN_TOPIC,
    EVENTS_TOPIC,
    OPERATOR_TOPIC,
    Schema,
    files,
    frame_schema,
    message_class,
    operator_schema,
    schema_of,
)

TICK, CAN, COMMANDS, EVENTS, TF, SCENE = 1, 2, 3, 4, 5, 6
"""MCAP identifiers of the channels."""
_MESSAGE = struct.Struct("<BQHIQQ")
"""Header of a Message record: opcode, size of the rest, channel, sequence, log and publish time, ns."""


class Messages(NamedTuple):
    """Complete MCAP Message records in file order, with the values for the message index."""

    data: Bytes
    """Bytes of the records, back to back."""
    start: Ints
    """(n + 1,) start of each record in `data`, and the end of the last one."""
    channel: Ints
    log_time: Ints
    tick: Ints
    """(n,) index in the batch of the tick of each record; chunks begin and end between ticks."""

    def records(self) -> Iterator[memoryview]:
        """Yield the MCAP records one by one."""
        data = self.data.data
        return (data[first:last] for first, last in pairwise(self.start.tolist()))


class _Rare(NamedTuple):
    """A message other than a row or frame, and its place: in the tick of `row`, before `item`."""

    row: int
    item: int
    channel: int
    log_time: int
    record: bytes


def channels_of(table: Table, can_channels: Sequence[str]) -> dict[int, tuple[str, Schema, dict[str, str]]]:
    """Topic, schema and metadata of each channel of a log, by channel identifier."""
    return {
        TICK: (table.topic, row_schema(table), {}),
        CAN: (CAN_TOPIC, frame_schema(), {"channel": ", ".join(can_channels)}),
        COMMANDS: (OPERATOR_TOPIC, operator_schema(), {}),
        EVENTS: (EVENTS_TOPIC, _foxglove(Log), {}),
        TF: ("/tf", _foxglove(FrameTransform), {}),
        SCENE: ("/scene", _foxglove(SceneUpdate), {}),
    }


class Encoder:
    """Turns batches of ticks into MCAP messages. State: number of the next tick, for events between ticks."""

    def __init__(
        self,
        table: Table,
        *,
        epoch_ns: int,
        can_channels: Sequence[str],
        scene: Scene | None,
        packer: tuple[str, bytes] | None = None,
    ) -> None:
        """Prepare the templates from columns, UTC of t_ns = 0, bus names and scene.

        `packer` is the machine code of `hil.record.packer.pack`; without it that module is imported.
        """
        codec = RowCodec(table.columns, TICK)
        template, places = self._row = codec.layout.template, codec.places
        frames, buses = frame_table([name.encode() for name in can_channels], CAN)
        self._frame = frames.template, buses
        self._largest_frame = int(buses[:, 1].max()) + MAX_DATA
        self._sizes = codec.dtype.itemsize // 8, len(places), len(template), len(buses), epoch_ns
        self._packer = packer
        self._epoch = epoch_ns
        self._view_every = scene.every if scene else VIEW_EVERY
        self._drawer = SceneDrawer(scene) if scene else None
        self._operator = message_class(operator_schema())
        self._next_tick = 0
        self.channels = channels_of(table, can_channels)

    @cached_property
    def _pack(self) -> Callable[..., int]:
        if self._packer is not None:
            return loaded(*self._packer)
        from hil.record.packer import pack  # noqa: PLC0415 - Numba

        return pack

    def encode(self, batch: Batch) -> Messages:
        """MCAP messages of a batch: for each tick its row, its frames and commands in order, its 3D view."""
        rows, items, of_row = batch
        count, total = len(rows), len(items)
        ticks = np.append(rows["tick"], rows["tick"][-1] + 1 if count else self._next_tick)
        times = np.append(rows["t_ns"], 0) + self._epoch
        self._next_tick = int(ticks[-1])
        rare = self._rare(batch, ticks.tolist(), times.tolist())
        records = b"".join([each.record for each in rare])
        places = [(each.row, each.item, len(each.record), each.channel, each.log_time) for each in rare]
        sizes = np.array([count, total, len(rare), *self._sizes])
        room = count * len(self._row[0]) + total * self._largest_frame + len(records) + 8
        out, index = np.empty(room, np.uint8), np.empty((count + total + len(rare) + 1, 4), np.int64)
        words = [np.ascontiguousarray(each).view(np.int64) for each in (rows, items)]
        rare_arrays = np.frombuffer(records, np.uint8), np.array(places, np.int64)
        when = np.concatenate((ticks, times, of_row))
        self._pack(sizes, when, *words, *self._row, *self._frame, *rare_arrays, out, index)
        start, channel, log_time, row = np.ascontiguousarray(index[: sizes[0] + 1].T)
        return Messages(out[: start[-1]], start, channel[:-1], log_time[:-1], row[:-1])

    def _rare(self, batch: Batch, ticks: Sequence[int], times: Sequence[int]) -> list[_Rare]:
        """Commands, events and 3D views of a batch as messages, in file order."""
        rows, items, of_row = batch
        found = []
        for i in np.flatnonzero(items["kind"] > SENT).tolist():
            n = int(of_row[i])
            if items[i]["kind"] == OPERATOR:
                index = i - int(np.searchsorted(of_row, n))
                found.append(self._command(items[i], n, i, ticks[n], times[n], index))
            elif not items[i]["id"]:  # the last piece
                found.append(self._event(items, n, i, ticks[n]))
        for n in np.flatnonzero(rows["tick"] % self._view_every == 0).tolist():
            found.extend(
                self._views(rows[n], n, int(np.searchsorted(of_row, n, "right")), ticks[n], times[n])
            )
        return sorted(found, key=lambda each: each[:2])

    def _command(self, item: Rows, n: int, i: int, tick: int, publish_ns: int, index: int) -> _Rare:
        time_ns = int(item["t_ns"]) + self._epoch
        numbers = unpack_numbers(bytes(item["data"][: item["length"]]))
        message = self._operator(command=int(item["id"]), tick=tick, index=index, setpoint=numbers)
        message.stamp.seconds, message.stamp.nanos = divmod(time_ns, 1_000_000_000)
        return _Rare(n, i, COMMANDS, time_ns, _record(COMMANDS, tick, time_ns, publish_ns, message))

    def _event(self, items: Rows, n: int, i: int, tick: int) -> _Rare:
        time_ns = int(items[i]["t_ns"]) + self._epoch
        message = Log(
            timestamp=_stamp(time_ns),
            level=Log.Level.ValueType(int(items[i]["flags"])),
            message=event_text(items, i),
            name="hil",
        )
        return _Rare(n, i, EVENTS, time_ns, _record(EVENTS, tick, time_ns, time_ns, message))

    def _views(self, row: Rows, n: int, i: int, tick: int, time_ns: int) -> list[_Rare]:
        stamp = _stamp(time_ns)
        messages = [(TF, data) for data in transforms(row, stamp)]
        scene = self._drawer.update(row, stamp) if self._drawer else None
        if scene is not None:
            messages.append((SCENE, scene))
        return [
            _Rare(n, i, channel, time_ns, _record(channel, tick, time_ns, time_ns, data))
            for channel, data in messages
        ]


def event_text(items: Rows, i: int) -> str:
    """Text of the event whose last piece is element i of `items`; an event spans one or more items."""
    first = i
    while first > 0 and items[first - 1]["kind"] == EVENT and items[first - 1]["id"] > 0:
        first -= 1
    data = b"".join(bytes(piece["data"][: piece["length"]]) for piece in items[first : i + 1])
    return data.decode(errors="replace")


def _stamp(time_ns: int) -> Timestamp:
    return Timestamp(seconds=time_ns // 1_000_000_000, nanos=time_ns % 1_000_000_000)


def _foxglove(message: Any) -> Schema:
    return schema_of(message.DESCRIPTOR.full_name, files(message.DESCRIPTOR.file))


def _record(channel: int, tick: int, log_time: int, publish_time: int, message: Any) -> bytes:
    payload = message if isinstance(message, bytes) else message.SerializeToString(deterministic=True)
    size = RECORD_HEADER - 9 + len(payload)
    return _MESSAGE.pack(Opcode.MESSAGE, size, channel, tick & 0xFFFFFFFF, log_time, publish_time) + bytes(
        payload
    )
