"""Messages of a batch: content, times and order in the file; schemas for other programs."""

from __future__ import annotations

import struct
from typing import Any, NamedTuple

import numpy as np
import pytest

from drivers.frame_array import FRAME
from drivers.protocol import BRS, ERROR, ESI, EXTENDED, FD, REMOTE
from hil.record.encode import Encoder, event_text
from hil.record.recording import Scene
from hil.record.ring import EVENT, OPERATOR, RECEIVED, SENT, Batch
from hil.record.row import TICKS
from hil.record.schema import message_class

HEADER = struct.Struct("<BQHIQQ")
"""Header of an MCAP Message record: opcode, bytes that follow, channel, sequence, log time, publish time."""
EPOCH = 1_700_000_000_123_456_789
S = 1_000_000_000
TICK, T_NS = 2**32 + 7, 2 * S - 1
"""Tick and time of the first row; each further row is a tick and a second later."""


class Message(NamedTuple):
    topic: str
    sequence: int
    log_time: int
    publish_time: int
    content: Any


def encoder(**options):
    return Encoder(TICKS, epoch_ns=EPOCH, **{"can_channels": ["can0"], "scene": None, **options})


def batch(rows, *items):
    """Batch of empty rows with items; an item: its row and its fields."""
    made = np.zeros(rows, TICKS.dtype)
    made["tick"] += TICK + np.arange(rows)
    made["t_ns"] += T_NS + S * np.arange(rows)
    table = np.zeros(len(items), FRAME)
    for each, (_, t_ns, number, kind, data, flags, bus) in zip(table, items, strict=True):
        each["t_ns"], each["id"], each["kind"], each["length"] = t_ns, number, kind, len(data)
        each["flags"], each["bus"] = flags, bus
        each["data"] = np.frombuffer(data + b"\xee" * (64 - len(data)), np.uint8)
    return Batch(made, table, np.array([row for row, *_ in items], np.int64))


def encoded(by, of):
    """Messages of a batch; the values for the index are compared with each message."""
    made = by.encode(of)
    found = []
    classes: dict[int, Any] = {}
    for data, channel, log_time in zip(
        made.records(), made.channel.tolist(), made.log_time.tolist(), strict=True
    ):
        opcode, size, number, sequence, logged, published = HEADER.unpack_from(data)
        assert (opcode, size, number, logged) == (5, len(data) - 9, channel, log_time)
        topic, schema, _ = by.channels[channel]
        kind = classes.get(number) or classes.setdefault(number, message_class(schema))
        content = kind.FromString(bytes(data[HEADER.size :]))
        found.append(Message(topic, sequence, logged, published, content))
    return found, made.tick.tolist()


ITEMS = (
    (0, 11, 0x123, RECEIVED, b"abc", EXTENDED, 0),
    (0, S, 0x1FFFFFFF, SENT, b"", REMOTE, 1),
    (0, 13, 0x7FF, RECEIVED, bytes(range(64)), FD | BRS, 1),
    (1, 14, 3, SENT, b"xyz", ERROR, 1),
    (1, 5 * S + 16, 5, SENT, b"0123456789ab", FD | ESI, 2),
)
"""Frames of two ticks; a frame of a bus without a name gets the name of the last bus."""


def test_frames_of_several_buses_keep_their_order_and_times():
    found, ticks = encoded(encoder(can_channels=["front", "rear bus"]), batch(2, *ITEMS))
    assert [m.topic for m in found] == ["/tick", *["/can"] * 3, "/tick", *["/can"] * 2]
    assert ticks == [0] * 4 + [1] * 3
    rows = [m for m in found if m.topic == "/tick"]
    assert [(m.content.tick, m.content.t_ns) for m in rows] == [(TICK, T_NS), (TICK + 1, T_NS + S)]
    assert [m.log_time - EPOCH for m in rows] == [m.publish_time - EPOCH for m in rows] == [T_NS, T_NS + S]
    frames = [m for m in found if m.topic == "/can"]
    for m, (row, t_ns, number, kind, data, _, bus), index in zip(frames, ITEMS, [0, 1, 2, 0, 1], strict=True):
        f = m.content
        assert (f.id, bytes(f.data), f.direction) == (number, data, 1 if kind == RECEIVED else 2)
        assert (f.channel, f.bus, f.tick, f.index) == (
            ["front", *["rear bus"] * 2][bus],
            bus,
            TICK + row,
            index,
        )
        assert f.dlc == {12: 9, 64: 15}.get(len(data), len(data))
        assert m.log_time == EPOCH + t_ns == f.header.stamp.seconds * S + f.header.stamp.nanos
        assert (m.publish_time, m.sequence) == (EPOCH + T_NS + S * row, 7 + row)


def test_commands_and_events_keep_their_place_among_the_frames():
    words = (
        (0, 11, 1, SENT, b"", 0, 0),
        (0, S + 12, 5, OPERATOR, struct.pack("<2d", 0.25, -3.0), 0, 0),
        (0, 13, 1, EVENT, b"a" * 64, 3, 0),
        (0, 2 * S + 14, 0, EVENT, b"b\xff", 4, 0),
        (0, 15, 2, OPERATOR, b"", 0, 0),
        (1, 16, 2, SENT, b"", 0, 0),
        (1, 17, 3, OPERATOR, b"", 0, 0),
        (2, 18, 0, EVENT, b"behind", 1, 0),
    )
    found, ticks = encoded(encoder(), batch(2, *words))
    topics = ["/tick", "/can", "/operator", "/events", "/operator", "/tick", "/can", "/operator", "/events"]
    assert [m.topic for m in found] == topics
    assert ticks == [0] * 5 + [1] * 3 + [2]
    assert [m.sequence for m in found] == [7] * 5 + [8] * 3 + [9]
    commands = [m for m in found if m.topic == "/operator"]
    assert [
        (m.content.command, m.content.tick, m.content.index, [*m.content.setpoint]) for m in commands
    ] == [(5, TICK, 1, [0.25, -3.0]), (2, TICK, 4, []), (3, TICK + 1, 1, [])]
    times = [EPOCH + S + 12, EPOCH + 15, EPOCH + 17]
    assert [m.log_time for m in commands] == times
    assert [m.publish_time - EPOCH for m in commands] == [T_NS, T_NS, T_NS + S]
    assert [m.content.stamp.seconds * S + m.content.stamp.nanos for m in commands] == times
    assert all(0 < m.content.stamp.nanos < S for m in commands)
    events = [m for m in found if m.topic == "/events"]
    assert [(m.content.message, m.content.level, m.content.name) for m in events] == [
        ("a" * 64 + "b�", 4, "hil"),
        ("behind", 1, "hil"),
    ]
    times = [EPOCH + 2 * S + 14, EPOCH + 18]
    assert [m.log_time for m in events] == [m.publish_time for m in events] == times
    assert [m.content.timestamp.seconds * S + m.content.timestamp.nanos for m in events] == times
    assert all(0 < m.content.timestamp.nanos < S for m in events)


@pytest.mark.parametrize("rows", [1, 2, 7])
def test_an_event_between_two_batches_belongs_to_the_next_tick(rows):
    by, event = encoder(), (0, 18, 0, EVENT, b"between", 1, 0)
    first, _ = encoded(by, batch(0, event))
    assert [m.sequence for m in first] == [0], "an event before the first tick has sequence 0"
    encoded(by, batch(rows))
    for _ in range(2):
        found, _ = encoded(by, batch(0, event))
        assert [m.sequence for m in found] == [rows + 7]


@pytest.mark.parametrize("length", [64, 65, 576, 577, 4000])
def test_an_event_of_any_length_keeps_its_whole_text(length):
    text = ("0123456789" * 400)[:length].encode()
    pieces = [text[k : k + 64] for k in range(0, length, 64)]
    items = [(0, 11, len(pieces) - 1 - k, EVENT, piece, 2, 0) for k, piece in enumerate(pieces)]
    (message,) = [m for m in encoded(encoder(), batch(1, *items))[0] if m.topic == "/events"]
    assert message.content.message == text.decode()


def test_text_of_an_event_split_over_items_has_only_its_own_items():
    pieces = [(EVENT, 0, b"before"), (EVENT, 2, b"a"), (EVENT, 1, b"b"), (EVENT, 0, b"c"), (OPERATOR, 1, b"x"),
              (EVENT, 1, b"d"), (EVENT, 0, b"e")]  # fmt: skip
    items = batch(0, *((0, 0, number, kind, data, 0, 0) for kind, number, data in pieces)).items
    assert [event_text(items, i) for i in (0, 3, 6)] == ["before", "abc", "de"]
    assert event_text(items[1:], 2) == "abc", "though its first piece is the first item"
    assert event_text(items[:2], 0) == "before", "though the last item is the piece of another"


@pytest.mark.parametrize(("scene", "every"), [(None, 33), (3, 3)])
def test_transform_and_scene_messages_are_the_last_messages_of_their_tick(scene, every):
    corners = [[1.0, k, 0.0] for k in range(6)]
    by = encoder(scene=Scene(corners, corners, every=scene) if scene else None)
    at = [every - 1, every, every + 1, 2 * every, 2 * every + 1]
    of = batch(len(at), *((row, 0, 1, SENT, b"", 0, 0) for row in range(len(at))))
    of.rows["tick"] = at
    of.rows["R"] = of.rows["R_d"] = np.eye(3).reshape(of.rows["R"].shape[1:])
    of.rows["p"], of.rows["p_d"] = 0.5, 0.25
    found, ticks = encoded(by, of)
    views = ["/tf", "/tf", *(["/scene"] if scene else [])]
    for row, tick in enumerate(at):
        here = [m for m, place in zip(found, ticks, strict=True) if place == row]
        assert [m.topic for m in here] == ["/tick", "/can", *(views if row in {1, 3} else [])]
        assert {m.sequence for m in here} == {tick}
        assert {m.log_time for m in here[2:]} <= {EPOCH + T_NS + S * row}
        assert {m.publish_time for m in here} == {EPOCH + T_NS + S * row}
        stamps = [m.content.timestamp for m in here if m.topic == "/tf"]
        stamps += [e.timestamp for m in here if m.topic == "/scene" for e in m.content.entities]
        assert {each.seconds * S + each.nanos for each in stamps} <= {EPOCH + T_NS + S * row}


@pytest.mark.parametrize(("names", "channel"), [(("front",), "front"), (("front", "rear"), "front, rear")])
def test_each_topic_has_a_channel_and_the_frame_channel_lists_its_buses(names, channel):
    channels = encoder(can_channels=names).channels
    assert {number: (topic, schema.name, about) for number, (topic, schema, about) in channels.items()} == {
        1: ("/tick", "hil.Tick", {}),
        2: ("/can", "hil.Frame", {"channel": channel}),
        3: ("/operator", "hil.OperatorCommand", {}),
        4: ("/events", "foxglove.Log", {}),
        5: ("/tf", "foxglove.FrameTransform", {}),
        6: ("/scene", "foxglove.SceneUpdate", {}),
    }
