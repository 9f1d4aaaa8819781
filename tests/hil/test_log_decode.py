"""What messages give that are not laid out as ours are: rows, frames, ticks; and which of them are refused."""

import numpy as np
import pytest
from mcap.records import Channel, Message
from mcap.records import Schema as SchemaRecord

from drivers.errors import LogError
from drivers.protocol import BUS, ESI, EXTENDED, FD, Frame, Received
from drivers.tick_columns import RECORDED, ROW
from hil.record.decode import ITEM, Decoder, why
from hil.record.entries import LoggedFrame, assemble, logged
from hil.record.layout import frame_layout, varint
from hil.record.mcap_file import record_bytes
from hil.record.mcap_read import split
from hil.record.row import TICKS, row_schema
from hil.record.schema import frame_schema, message_class
from hil.signals import Operator, Order, SetPoint
from tests.hil.samples import packed_rows, random_rows

HEAD = 31
"""Bytes of the record in front of the data of a message."""
ROWS, FRAMES = 1, 2
"""Channels."""
BUSES = ["can0", "the_second_can"]


@pytest.fixture(scope="module")
def decoder():
    found = Decoder("a.mcap")
    for number, topic, schema in ((ROWS, "/tick", row_schema(TICKS)), (FRAMES, "/can", frame_schema())):
        found.learn(SchemaRecord(id=number, name=schema.name, encoding="protobuf", data=schema.descriptors))
        found.learn(
            Channel(id=number, topic=topic, message_encoding="protobuf", metadata={}, schema_id=number)
        )
    found.expect("/tick", RECORDED, BUSES, 5_000_000_000)
    return found


def buffer(channel, payloads):
    data = b"".join(
        record_bytes(Message(channel_id=channel, log_time=0, publish_time=0, sequence=0, data=payload))
        for payload in payloads
    )
    return data, split(data)[0]


def laid_out(rows):
    """Messages of rows as ours are."""
    return packed_rows(TICKS, rows)


def padding(size):
    """A field of no meaning, of so many bytes, from 132 on."""
    return varint(2000 << 3 | 2) + varint(size - 4) + bytes(size - 4)


# -- rows ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("place", [0, 1, 2])
def test_a_field_that_stands_twice_in_a_message_has_its_last_value_beside_rows_as_ours_are(decoder, place):
    rows = random_rows(3)
    payloads = laid_out(rows)
    number = 1 + (ROW.names or ()).index("tick")
    payloads[place] += varint(number << 3 | 1) + (777).to_bytes(8, "little")
    rows["tick"][place] = 777
    assert decoder.rows(*buffer(ROWS, payloads)).tobytes() == rows.tobytes()


@pytest.mark.parametrize("places", [[0], [2], [0, 1, 2]], ids=str)
def test_a_row_whose_fields_another_writer_put_in_another_order_is_read_by_their_numbers(decoder, places):
    """It is as long as ours; tick and t_ns take a tag and eight bytes each, and stand first."""
    rows = random_rows(3)
    rows["tick"], rows["t_ns"] = [7, 8, 9], [1000, 2000, 3000]
    payloads = laid_out(rows)
    assert list(ROW.names or ())[:2] == ["tick", "t_ns"]
    for place in places:
        given = payloads[place]
        payloads[place] = given[9:18] + given[:9] + given[18:]
        assert len(payloads[place]) == len(given)
    assert decoder.rows(*buffer(ROWS, payloads)).tobytes() == rows.tobytes()


def empty_rows(more):
    """Messages in which all is left out, so many that rows may have 1 MiB beyond 8 times their bytes, and `more`.

    The last one has a field of no meaning, which makes up for the rest.
    """
    count = (1 << 20) // (ROW.itemsize - 8 * HEAD) + 4
    most, rest = divmod(count * ROW.itemsize - (1 << 20), 8)
    assert rest == 0
    data, table = buffer(ROWS, [b""] * (count - 1) + [padding(most - count * HEAD + more)])
    assert len(data) == most + more
    return count, data, table


def test_rows_may_take_8_times_the_bytes_of_their_messages_and_1_MiB_more(decoder):
    count, data, table = empty_rows(0)
    assert decoder.rows(data, table).tobytes() == bytes(count * ROW.itemsize)


def test_rows_of_messages_that_are_a_byte_too_short_are_refused_with_both_sizes(decoder):
    count, data, table = empty_rows(-1)
    with pytest.raises(LogError) as refused:
        decoder.rows(data, table)
    assert str(refused.value) == (
        f"a.mcap: {count} messages of /tick of {len(data)} bytes together are too short for rows of "
        f"{ROW.itemsize} bytes"
    )


def among_frames(first, second, third):
    """A buffer with three messages of rows, and those of frames between them."""
    of_frames = buffer(FRAMES, [frame()])[0]
    one, two, three = (buffer(ROWS, [payload])[0] for payload in (first, second, third))
    data = of_frames + one + buffer(FRAMES, [b""])[0] + two + three + of_frames
    return data, split(data)[0]


@pytest.fixture
def without_parser(monkeypatch):
    def parsed(*_):
        raise AssertionError("a parser was asked")

    monkeypatch.setattr(Decoder, "_protobuf", parsed)


def test_rows_as_ours_are_taken_from_among_frames_without_a_parser(decoder, without_parser):
    rows = random_rows(3)
    assert decoder.rows(*among_frames(*laid_out(rows))).tobytes() == rows.tobytes()


def test_rows_of_which_one_is_longer_are_taken_from_among_frames(decoder):
    rows = random_rows(3)
    first, second, third = laid_out(rows)
    found = decoder.rows(*among_frames(first, second + padding(200), third))
    assert found.tobytes() == rows.tobytes()


# -- frames --------------------------------------------------------------------------------------------------


def frame(**values):
    message = message_class(frame_schema())(**values)
    message.header.stamp.seconds, message.header.stamp.nanos = 5, 3
    return message.SerializeToString()


@pytest.mark.parametrize("size", [0, 1, 63, 64])
def test_a_frame_of_another_layout_has_up_to_64_bytes_and_all_that_was_said_of_it(decoder, size):
    data = bytes(range(1, size + 1))
    said = frame(data=data, id=9, is_extended=True, fdf=True, direction=2, tick=7, index=4, bus=3)
    items = decoder.frames(*buffer(FRAMES, [frame(), said]))
    assert items["index"].tolist() == [0, 4]
    assert list(logged(items)) == [
        LoggedFrame(3, 0, False, 0, 0, b"", 0),
        LoggedFrame(3, 7, True, 3, 9, data, EXTENDED | FD),
    ]


def frame_as_ours(channel, size, **values):
    """A message whose layout is that of ours; its data count from 1, its time is 7 s and 123456789 ns."""
    layout = frame_layout(size, channel)
    record = np.frombuffer(bytearray(layout.template[HEAD:].tobytes()), layout.payload)
    for name in layout.payload.names or ():
        record[name] = values.get(name, 0)
    record["seconds"], record["nanos"] = list(b"\x87\x80\x80\x80\x00"), list(b"\x95\x9a\xef\xba\x00")
    if size:
        record["data"] = np.arange(1, size + 1)
    return record.tobytes()


def test_frames_as_ours_have_all_that_was_said_of_them_on_buses_of_long_and_short_names(
    decoder, without_parser
):
    sizes = [8, 64, 0, 63, 8, 1]
    flags = {"is_extended": 1, "fdf": 2, "brs": 4, "esi": 8, "is_rtr": 16, "is_error": 32}
    payloads = [
        frame_as_ours(
            BUSES[k % 2].encode(), size, id=100 + k, direction=1 + k // 3, tick=200 + k, index=300 + k, bus=k,
            **{name: 1},
        )
        for k, (size, name) in enumerate(zip(sizes, flags, strict=True))
    ]  # fmt: skip
    items = decoder.frames(*buffer(FRAMES, payloads))
    assert items["index"].tolist() == [300, 301, 302, 303, 304, 305]
    assert list(logged(items)) == [
        LoggedFrame(
            2_123_456_789, 200 + k, k >= 3, k, 100 + k, bytes(range(1, sizes[k] + 1)), list(flags.values())[k]
        )
        for k in range(6)
    ]


def test_a_frame_as_ours_on_a_bus_of_another_name_is_read_between_those_of_ours(decoder):
    payloads = [
        frame_as_ours(channel, 8, id=100 + k, tick=200 + k, is_extended=min(k, 1))
        for k, channel in enumerate([b"canX", b"can0", b"canX", b"can0"])
    ]
    payloads[3] = payloads[3].replace(bytes(range(1, 9)), b"12345678")
    found = list(logged(decoder.frames(*buffer(FRAMES, payloads))))
    assert [(f.id, f.tick, f.t_ns, f.flags) for f in found] == [
        (100 + k, 200 + k, 2_123_456_789, min(k, 1)) for k in range(4)
    ]
    assert [f.data for f in found] == [bytes(range(1, 9))] * 3 + [b"12345678"]


def test_a_flag_of_a_frame_is_set_whatever_number_stands_for_true(decoder):
    """Protobuf takes each number but 0 for true, on whichever bus."""
    payloads = [
        frame_as_ours(channel, 8, is_extended=number, fdf=0, esi=number)
        for channel in (b"can0", b"canX")
        for number in (0, 1, 2, 3, 127)
    ]
    assert decoder.frames(*buffer(FRAMES, payloads))["flags"].tolist() == [0, *[EXTENDED | ESI] * 4] * 2


@pytest.mark.parametrize("size", [65, 200])
def test_a_frame_of_more_bytes_than_can_carries_is_refused_with_their_number(decoder, size):
    with pytest.raises(LogError, match=rf"^a\.mcap: a frame with {size} data bytes: at most 64$"):
        decoder.frames(*buffer(FRAMES, [frame(), frame(data=bytes(size))]))


# -- damage --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("payload", [b"\xff", b"\x0a\x7f", laid_out(random_rows(1))[0][:-1]], ids=len)
def test_a_message_that_its_schema_does_not_read_is_refused_with_its_topic(decoder, payload):
    for read, channel, topic in (
        (decoder.rows, ROWS, "/tick"),
        (decoder.frames, FRAMES, "/can"),
        (lambda data, table: list(decoder.messages(data, table, "/can")), FRAMES, "/can"),
    ):
        with pytest.raises(
            LogError, match=rf"^a\.mcap: a message of {topic} is damaged or of another kind: "
        ):
            read(*buffer(channel, [b"", payload]))


def test_messages_whose_schema_is_missing_are_refused_with_their_topic():
    lone = Decoder("a.mcap")
    lone.learn(Channel(id=FRAMES, topic="/can", message_encoding="", metadata={}, schema_id=FRAMES))
    lone.expect("/tick", RECORDED, ["can0"], 0)
    with pytest.raises(LogError, match=r"^a\.mcap: a message of /can is damaged or of another kind: "):
        lone.frames(*buffer(FRAMES, [frame()]))


# -- ticks ---------------------------------------------------------------------------------------------------


def items_of(*entries):
    """Items in the order given: tick, direction, index; their identifiers count from 1."""
    items = np.zeros(len(entries), ITEM)
    for k, (tick, direction, index) in enumerate(entries):
        items[k]["tick"], items[k]["direction"], items[k]["index"] = tick, direction, index
        items[k]["id"], items[k]["t_ns"] = k + 1, 10 * (k + 1)
    return items


def test_a_tick_has_the_frames_that_are_said_to_be_received_or_sent_and_no_others():
    """Another program may have written directions that nothing names, and frames of ticks that have no row."""
    directions = (0, 1, 2, 3, 4, 5, 6, 9, 255)
    items = items_of(*[(tick, direction, 0) for tick in (4, 5, 6, 7) for direction in directions])
    found = list(assemble(random_rows(7)[5:], items, {}))
    assert [tick.received for tick in found] == [
        (Received(110, Frame(11, b"", 0)),),
        (Received(200, Frame(20, b"", 0)),),
    ]
    assert [tick.sent for tick in found] == [(Frame(12, b"", 0),), (Frame(21, b"", 0),)]


def test_frames_of_a_tick_stand_by_their_index_each_way_for_itself_wherever_they_lay():
    items = items_of((0, 2, 9), (0, 1, 5), (0, 2, 1), (0, 1, 2), (0, 1, 7))
    items["length"], items["bus"] = [1, 2, 3, 64, 0], [0, 5, 1, 0, 255]
    items["data"] = np.arange(5 * 64).reshape(5, 64) % 250
    (tick,) = assemble(random_rows(1), items, {})
    data = [bytes((64 * k + b) % 250 for b in range(n)) for k, n in enumerate([1, 2, 3, 64, 0])]
    assert tick.received == (
        Received(40, Frame(4, data[3], 0)),
        Received(20, Frame(2, data[1], 5 * BUS)),
        Received(50, Frame(5, b"", 255 * BUS)),
    )
    assert tick.sent == (Frame(3, data[2], BUS), Frame(1, data[0], 0))


def test_commands_of_a_tick_stand_by_their_index_each_kind_for_itself():
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


@pytest.mark.parametrize(
    ("error", "told"),
    [
        (KeyError("tau"), "it has no 'tau'"),
        (KeyError(3), "it has no 3"),
        (KeyError(), "something is missing"),
        (ValueError("no number"), "no number"),
        (RecursionError(), "RecursionError"),
    ],
)
def test_what_is_wrong_with_data_of_unknown_making_is_said_in_words(error, told):
    assert why(error) == told
