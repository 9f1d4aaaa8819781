"""Messages give rows, frames and ticks; those in another layout are refused with their topic."""

import numpy as np
import pytest
from mcap.records import Channel, Message

from drivers.errors import LogError
from drivers.protocol import BUS, ESI, EXTENDED, Frame, Received
from drivers.tick_columns import RECORDED
from hil.record.decode import ITEM, Decoder
from hil.record.entries import assemble
from hil.record.layout import FRAME_FLAGS, frame_table
from hil.record.mcap_file import record_bytes
from hil.record.mcap_read import split
from hil.record.ring import RECEIVED, SENT
from hil.record.row import TICKS
from hil.signals import Operator, Order, SetPoint
from tests.hil.samples import packed_rows, random_rows

HEAD = 31
"""Bytes of the record in front of the data of a message."""
ROWS, FRAMES, COMMANDS, EVENTS = 1, 2, 3, 4
"""Channels."""
BUSES = ["can0", "the_second_can"]


@pytest.fixture(scope="module")
def decoder():
    found = Decoder("a.mcap")
    for number, topic in {ROWS: "/tick", FRAMES: "/can", COMMANDS: "/operator", EVENTS: "/events"}.items():
        found.learn(Channel(id=number, topic=topic, message_encoding="", metadata={}, schema_id=number))
    found.expect("/tick", RECORDED, BUSES, 5_000_000_000)
    return found


def buffer(channel, payloads):
    data = b"".join(
        record_bytes(Message(channel_id=channel, log_time=0, publish_time=0, sequence=0, data=payload))
        for payload in payloads
    )
    return data, split(data)[0]


def frame(name, size, **values):
    """A message as the recorder lays it out; its data count from 1, its time is 7 s and 123456789 ns."""
    layout, ((_, _, data, *places),) = frame_table([name])
    fields = dict(
        zip(
            ("seconds", "nanos", "id", "dlc", "direction", "tick", "index", "bus", *FRAME_FLAGS),
            places,
            strict=True,
        )
    )
    record = bytearray(layout.template.tobytes())
    given = {"seconds": b"\x87\x80\x80\x80\x00", "nanos": b"\x95\x9a\xef\xba\x00", "direction": b"\x01"}
    sizes = {"id": 4, "tick": 8, "index": 4}
    given |= {field: value.to_bytes(sizes.get(field, 1), "little") for field, value in values.items()}
    for field, value in given.items():
        record[fields[field] : fields[field] + len(value)] = value
    record[data - 1] = size
    record[data:data] = bytes(range(1, size + 1))
    return bytes(record[HEAD:])


def test_any_number_but_0_sets_a_flag_of_a_frame(decoder):
    """Protobuf takes each number but 0 for true."""
    payloads = [frame(b"can0", 8, is_extended=number, fdf=0, esi=number) for number in (0, 1, 2, 3, 127)]
    found = decoder.frames(*buffer(FRAMES, payloads))["frame"]["flags"].tolist()
    assert found == [0, *[EXTENDED | ESI] * 4]


ROW_0, ROW_1 = packed_rows(TICKS, random_rows(2))


@pytest.mark.parametrize(
    ("topic", "payload"),
    [
        ("/can", b""),
        ("/can", b"\xff" * 300),
        ("/can", frame(b"canX", 8)),
        ("/can", frame(b"can0", 8)[:-1]),
        ("/can", frame(b"can0", 65)),
        ("/can", frame(b"can0", 8, direction=0)),
        ("/can", frame(b"can0", 8, direction=3)),
        ("/tick", ROW_1[:-1]),
        ("/tick", ROW_1 + b"\0"),
        ("/tick", ROW_1[9:18] + ROW_1[:9] + ROW_1[18:]),
        ("/operator", b"\xff"),
        ("/events", b"\xff"),
    ],
)
def test_a_message_in_another_layout_is_refused_with_its_topic(decoder, topic, payload):
    number, good, read = {
        "/can": (FRAMES, frame(b"can0", 8), decoder.frames),
        "/tick": (ROWS, ROW_0, decoder.rows),
        "/operator": (COMMANDS, b"", lambda *found: list(decoder.messages(*found, "/operator"))),
        "/events": (EVENTS, b"", lambda *found: list(decoder.messages(*found, "/events"))),
    }[topic]
    with pytest.raises(LogError, match=rf"^a\.mcap: a message of {topic} is damaged or of another kind: "):
        read(*buffer(number, [good, payload]))


def items_of(*entries):
    """Items in the order given: tick, direction, index; their identifiers count from 1."""
    items = np.zeros(len(entries), ITEM)
    for k, (tick, direction, index) in enumerate(entries):
        items[k]["tick"], items[k]["index"] = tick, index
        items["frame"]["kind"][k] = SENT if direction == 2 else RECEIVED
        items["frame"]["id"][k], items["frame"]["t_ns"][k] = k + 1, 10 * (k + 1)
    return items


def test_frames_of_a_tick_stand_in_the_order_of_their_index():
    items = items_of((0, 2, 9), (0, 1, 5), (0, 2, 1), (0, 1, 2), (0, 1, 7))
    frames = items["frame"]
    frames["length"], frames["bus"] = [1, 2, 3, 64, 0], [0, 5, 1, 0, 255]
    frames["data"] = np.arange(5 * 64).reshape(5, 64) % 250
    (tick,) = assemble(random_rows(1), items, {})
    data = [bytes((64 * k + b) % 250 for b in range(n)) for k, n in enumerate([1, 2, 3, 64, 0])]
    assert tick.received == (
        Received(40, Frame(4, data[3], 0)),
        Received(20, Frame(2, data[1], 5 * BUS)),
        Received(50, Frame(5, b"", 255 * BUS)),
    )
    assert tick.sent == (Frame(3, data[2], BUS), Frame(1, data[0], 0))


def test_commands_of_a_tick_stand_in_the_order_of_their_index():
    pose = (1.0, 2.0, 3.0, 4.0, 5.0, 6.0)
    commands = {
        1: [
            (9, int(Operator.HOLD), ()),
            (2, int(Operator.STOP), ()),
            (8, int(Operator.SETPOINT), pose[::-1]),
            (1, int(Operator.RESET), ()),
            (4, int(Operator.SPEED), (0.5,)),
            (3, int(Operator.SETPOINT), pose),
        ]
    }
    before, tick = assemble(random_rows(2), items_of(), commands)
    assert (before.operator, before.setpoints, before.orders) == ((), (), ())
    assert tick.operator == (Operator.RESET, Operator.STOP)
    assert tick.setpoints == (SetPoint(*pose), SetPoint(*pose[::-1]))
    assert tick.orders == (Order(Operator.SPEED, (0.5,)), Order(Operator.HOLD))
