"""Data read from a chunk agree with the mcap library and protobuf."""

import struct
from collections import defaultdict
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.records import Chunk, Message
from mcap.stream_reader import StreamReader, breakup_chunk

from drivers.errors import LogError
from drivers.frame_array import FRAME
from drivers.protocol import BRS, BUS, ERROR, ESI, EXTENDED, FD, REMOTE, Frame, Received
from drivers.tick_columns import ROW
from hil.record import Recording
from hil.record.entries import Command, assemble
from hil.record.layout import ITEM as PLACED
from hil.record.layout import frame_table, scan, unpack_frames, unpack_rows
from hil.record.log import Log, Tick
from hil.record.mcap_file import record_bytes
from hil.record.mcap_read import Allowance, Record, messages_in
from hil.record.ring import RECEIVED, SENT
from hil.record.row import TICKS, RowCodec
from hil.record.schema import Schema, message_class
from hil.signals import Operator, Order, SetPoint
from tests.hil.rewrite import rewrite_log
from tests.hil.samples import assert_same, packed_rows, random_rows, random_ticks, record

BUSES = ["can0", "the_second_can"]
RECORDED = random_ticks(120, seed=31)
ITEM = struct.Struct("<qIBBH64s")
"""Frame in the ring."""


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    path = tmp_path_factory.mktemp("log") / "a.mcap"
    with Recording.start(path, configuration="", lockstep=True, can_channel=BUSES) as recording:
        recording.event(1, "info", "it begins")
        record(recording, RECORDED)
    return path


@pytest.fixture
def log(path):
    return Log(path)


@pytest.fixture(scope="module")
def messages(path):
    """Messages by topic, found by the library and decoded by protobuf."""
    found = defaultdict(list)
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file, validate_crcs=True).iter_messages(
            log_time_order=False
        ):
            assert schema is not None
            kind = message_class(Schema(schema.name, schema.data))
            found[channel.topic].append(kind.FromString(message.data))
    return found


def test_messages_of_a_chunk_agree_with_the_mcap_library(path):
    with path.open("rb") as file:
        chunks = [each for each in StreamReader(file, emit_chunks=True).records if isinstance(each, Chunk)]
    for chunk in chunks:
        content = record_bytes(chunk)[9:]
        record = Record(6, 0, len(content), content)
        data, table, channels = messages_in(record, Allowance(0))
        theirs = [each for each in breakup_chunk(chunk) if isinstance(each, Message)]
        assert table.channel.tolist() == [each.channel_id for each in theirs]
        assert table.sequence.tolist() == [each.sequence for each in theirs]
        assert table.log_time.tolist() == [each.log_time for each in theirs]
        starts, stops = table.offset + 31, table.offset + table.length
        assert [data[a:b] for a, b in zip(starts, stops, strict=True)] == [each.data for each in theirs]
        assert channels == []
    assert len(chunks) > 1


def test_rows_agree_with_protobuf(log, messages):
    for column in log.columns:
        name = f"{column.name}_number" if column.names else column.name
        found = [getattr(message, name) for message in messages["/tick"]]
        if column.elements:
            found = [[getattr(each, element) for element in column.elements] for each in found]
        values = log.rows(column.name)[column.name]
        np.testing.assert_array_equal(values, np.reshape(found, values.shape), err_msg=column.name)
    assert log.rows().tobytes() == np.array([tick.row for tick in RECORDED]).tobytes()


def test_frames_agree_with_protobuf(log, messages):
    flags = {"is_extended": EXTENDED, "fdf": FD, "brs": BRS, "esi": ESI, "is_rtr": REMOTE, "is_error": ERROR}
    expected = []
    for message in messages["/can"]:
        stamp = message.header.stamp
        bits = sum(bit for name, bit in flags.items() if getattr(message, name))
        t_ns = stamp.seconds * 1_000_000_000 + stamp.nanos - log.epoch_ns
        place = t_ns, message.tick, message.direction == 2, message.bus
        expected.append((*place, message.id, message.data, bits))
    assert list(log.can_frames()) == sorted(expected, key=lambda each: each[0])


def test_binary_frame_items_of_a_tick_agree_with_its_frame_tuples(log, messages):
    assert_same(log.ticks(), RECORDED)
    sent_at = defaultdict(list)
    for message in messages["/can"]:
        if message.direction == 2:
            stamp = message.header.stamp
            sent_at[message.tick].append(stamp.seconds * 1_000_000_000 + stamp.nanos - log.epoch_ns)
    for found, tick in zip(log.ticks(), RECORDED, strict=True):
        sent = map(Received, sent_at[int(tick.row["tick"])], tick.sent)
        for items, kind, frames in (
            (found.received_items, RECEIVED, tick.received),
            (found.sent_items, SENT, sent),
        ):
            packed = b"".join(ITEM.pack(t_ns, f.id, kind, len(f.data), f.flags, f.data) for t_ns, f in frames)
            assert (items.dtype, items.tobytes()) == (FRAME, packed)
            assert not items.flags.writeable
            assert items.flags.c_contiguous


def test_tick_changed_by_frame_tuples_gets_the_matching_binary_items():
    tick = RECORDED[5]
    frame = Frame(0x123, b"\x01\x02", FD | 3 * BUS)
    other = tick._replace(received=(Received(7, frame),), sent=(frame,))
    assert other.received_items.tobytes() == ITEM.pack(7, 0x123, RECEIVED, 2, 0x302, frame.data)
    assert other.sent_items.tobytes() == ITEM.pack(0, 0x123, SENT, 2, 0x302, frame.data)
    assert Tick(tick.row, other.received_items, other.sent_items, ()).received == other.received
    assert (other.received, other.sent) == ((Received(7, frame),), (frame,))
    assert (other.row, other.operator, other.setpoints, other.orders) == (
        tick.row, tick.operator, tick.setpoints, tick.orders,
    )  # fmt: skip


@pytest.mark.parametrize("length", [0, 8, 64])
def test_frame_with_a_changed_constant_byte_is_refused(length):
    layout, table = frame_table([b"can0"])
    _, _, data, *places = table[0].tolist()
    template, mask = (np.insert(each, [data] * length, 0) for each in layout)
    template[data - 1], template[places[4] + length] = length, 1
    items = np.zeros(1, PLACED)

    def taken(record):
        start, size = np.zeros(1, np.int64), np.array([len(record)])
        return unpack_frames(record.tobytes(), start, size, 0, layout, table, items)

    assert taken(template)
    for at in [data - 1, *np.flatnonzero(mask).tolist()]:
        record = template.copy()
        record[at] ^= 1
        assert not taken(record), at


def test_row_with_a_changed_constant_byte_is_refused():
    codec = RowCodec(TICKS.columns)
    rows = random_rows(3)
    records = np.array([[0] * 31 + list(payload) for payload in packed_rows(TICKS, rows)], np.uint8)
    starts, found = np.arange(3) * records.shape[1], np.empty((3, ROW.itemsize // 8), np.int64)
    for at in [None, *np.flatnonzero(codec.layout.mask).tolist()]:
        data = records.copy()
        if at is not None:
            data[1, at] ^= 1
        assert unpack_rows(data.tobytes(), starts, codec.layout, codec.read, found) == (at is None)
        assert at is not None or found.tobytes() == rows.tobytes()


WHOLE = struct.pack("<BQHIQQ", 5, 22, 1, 0, 0, 0)


@pytest.mark.parametrize(
    "count", [13, 23, 31, 1 << 31, 1 << 32, (1 << 63) - 1, 1 << 63, (1 << 64) - 9, (1 << 64) - 1]
)
def test_message_beyond_the_end_of_the_data_is_not_read(count):
    starts, end = scan(WHOLE + struct.pack("<BQHIQQ", 5, count, 1, 0, 0, 0))
    assert (starts.tolist(), end) == ([0], 31)


@pytest.mark.parametrize("size", range(32))
def test_incomplete_rest_after_the_last_message_is_not_read(size):
    starts, end = scan(WHOLE + WHOLE[:size])
    assert (starts.tolist(), end) == (([0, 31], 62) if size == 31 else ([0], 31))


@pytest.mark.parametrize(
    ("topic", "payload"),
    [
        ("/can", b""),
        ("/can", b"\xff" * 300),
        ("/tick", b""),
        ("/tick", packed_rows(TICKS, random_rows(1))[0] + b"\0"),
        ("/operator", b"\xff"),
        ("/events", b"\xff"),
    ],
)
def test_message_with_another_layout_is_refused_with_its_topic(path, tmp_path, topic, payload):
    changed: list[str] = []

    def edit(kind, data, _):
        if kind != topic or changed:
            return data
        changed.append(kind)
        return payload

    rewrite_log(path, tmp_path / "a.mcap", edit)
    log = Log(tmp_path / "a.mcap")
    assert changed
    reads: dict[str, Any] = {"/can": lambda: list(log.can_frames()), "/events": log.events}
    with pytest.raises(LogError, match=rf"a\.mcap: a message of {topic} is damaged or of another kind: "):
        reads.get(topic, lambda: list(log.ticks()))()


@pytest.mark.parametrize("topic", ["/tick", "/can"])
def test_tick_number_that_differs_from_its_message_is_refused(path, tmp_path, topic):
    rewrite_log(path, tmp_path / "a.mcap", sequence=lambda kind, tick: tick + (kind == topic and tick == 50))
    with pytest.raises(LogError, match="not in the order of a recorder, near tick"):
        Log(tmp_path / "a.mcap").rows()


def items_of(*entries):
    """Items in the given order: tick, direction, index; their identifiers count from 1."""
    items = np.zeros(len(entries), PLACED)
    for k, (tick, direction, index) in enumerate(entries):
        items[k]["tick"], items[k]["index"] = tick, index
        items["frame"]["kind"][k] = SENT if direction == 2 else RECEIVED
        items["frame"]["id"][k], items["frame"]["t_ns"][k] = k + 1, 10 * (k + 1)
    return items


def test_frames_of_a_tick_are_sorted_by_index():
    items = items_of((0, 2, 9), (0, 1, 5), (0, 2, 1), (0, 1, 2), (0, 1, 7))
    frames = items["frame"]
    frames["length"], frames["bus"] = [1, 2, 3, 64, 0], [0, 5, 1, 0, 255]
    frames["data"] = np.arange(5 * 64).reshape(5, 64) % 250
    (tick,) = assemble(random_rows(1), items, [])
    data = [bytes((64 * k + b) % 250 for b in range(n)) for k, n in enumerate([1, 2, 3, 64, 0])]
    assert tick.received == (
        Received(40, Frame(4, data[3], 0)),
        Received(20, Frame(2, data[1], 5 * BUS)),
        Received(50, Frame(5, b"", 255 * BUS)),
    )
    assert tick.sent == (Frame(3, data[2], BUS), Frame(1, data[0], 0))


def test_commands_of_a_tick_are_sorted_by_index():
    pose = (1.0, 2.0, 3.0, 4.0, 5.0, 6.0)
    given: list[tuple[int, Operator, tuple[float, ...]]] = [
        (9, Operator.HOLD, ()),
        (2, Operator.STOP, ()),
        (8, Operator.SETPOINT, pose[::-1]),
        (1, Operator.RESET, ()),
        (4, Operator.SPEED, (0.5,)),
        (3, Operator.SETPOINT, pose),
    ]
    commands = [Command(1, *each) for each in given]
    before, tick = assemble(random_rows(2), items_of(), commands)
    assert (before.operator, before.setpoints, before.orders) == ((), (), ())
    assert tick.operator == (Operator.RESET, Operator.STOP)
    assert tick.setpoints == (SetPoint(*pose), SetPoint(*pose[::-1]))
    assert tick.orders == (Order(Operator.SPEED, (0.5,)), Order(Operator.HOLD))
