"""When the messages of a log are said to be: on the clock of the world, each with the instant of its tick or its own."""

import struct
from pathlib import Path
from typing import Any, cast

import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from drivers.protocol import Frame, Received
from hil.record import Recording, Scene
from hil.record.encode import EVENTS, Encoder
from hil.record.encode import TICK as ROWS
from hil.record.ring import Ring
from hil.record.row import TICKS
from hil.signals import Operator, Order, SetPoint
from tests.hil.samples import random_rows

EPOCH_2000 = 946_684_800_000_000_000  # date -u -d 2000-01-01 +%s
HEARD = 2_999_999_999
"""t_ns of a frame; that of its tick is a little later, in another second."""
TICK = 3_000_000_001
SAID = 3_500_000_007
"""t_ns of an event."""


@pytest.fixture(scope="module")
def messages(tmp_path_factory):
    """Topic, message and its content, of a log of one tick that has all of them."""
    path = tmp_path_factory.mktemp("log") / "a.mcap"
    (row,) = random_rows(1)
    row["tick"], row["t_ns"] = 66, TICK
    for name in ("p", "p_d", "R", "R_d"):
        row[name] = 0.5
    corners = [[1.0, k, 0.0] for k in range(6)]
    with Recording.start(
        path, configuration="", lockstep=True, scene=Scene(corners, corners, every=33)
    ) as recording:
        recording.tick(
            row,
            [Received(HEARD, Frame(1, b"", 0))],
            [Frame(2, b"", 0)],
            [int(Operator.STOP)],
            [SetPoint(1.0, 2.0, 3.0, 4.0, 5.0, 6.0)],
            [Order(Operator.SPEED, (0.5,))],
        )
        recording.event(SAID, "info", "a" * 100)
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        return [(c.topic, m, d) for _, c, m, d in reader.iter_decoded_messages(log_time_order=False)]


def ns(stamp):
    return int(stamp.seconds) * 10**9 + int(stamp.nanos)


def test_each_message_has_its_own_instant_in_the_index_and_that_of_its_tick_as_published(messages):
    found = [(topic, m.log_time - EPOCH_2000, m.publish_time - EPOCH_2000) for topic, m, _ in messages]
    assert found == [
        ("/tick", TICK, TICK),
        ("/can", HEARD, TICK),
        ("/can", TICK, TICK),
        *[("/operator", TICK, TICK)] * 3,
        *[("/tf", TICK, TICK)] * 2,
        ("/scene", TICK, TICK),
        ("/events", SAID, SAID),
    ]


def test_the_stamp_in_a_message_is_its_instant_in_the_index(messages):
    stamps = {
        "/can": lambda d: [d.header.stamp],
        "/operator": lambda d: [d.stamp],
        "/tf": lambda d: [d.timestamp],
        "/scene": lambda d: [e.timestamp for e in d.entities],
        "/events": lambda d: [d.timestamp],
    }
    seen = 0
    for topic, message, content in messages:
        for stamp in stamps.get(topic, lambda _: [])(content):
            assert ns(stamp) == message.log_time, topic
            assert 0 <= stamp.nanos < 10**9
            seen += 1
    assert seen == 2 + 3 + 2 + 3 + 1


def test_a_command_has_its_tick_and_its_place_among_the_items_of_the_tick(messages):
    commands = [d for topic, _, d in messages if topic == "/operator"]
    assert [(d.tick, d.index, d.command, list(d.setpoint)) for d in commands] == [
        (66, 2, Operator.STOP, []),
        (66, 3, Operator.SETPOINT, [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]),
        (66, 4, Operator.SPEED, [0.5]),
    ]


def test_the_sequence_of_a_message_is_the_number_of_its_tick_that_of_an_event_of_the_next_one(messages):
    assert [m.sequence for topic, m, _ in messages] == [
        67 if topic == "/events" else 66 for topic, _, _ in messages
    ]


def test_an_event_after_the_rows_of_a_batch_has_the_sequence_of_the_tick_to_come():
    ring, nobody = Ring.create(TICKS.dtype, 256), cast("Any", None)
    recording = Recording(ring, nobody, Path("a.mcap"), lockstep=True)
    encoder = Encoder(TICKS, epoch_ns=0, can_channels=["can0"], scene=None)
    found: list[tuple[int, int]] = []

    def drain():
        batch = ring.take(256)
        for each in encoder.encode(batch).records():
            found.append(struct.unpack_from("<HI", each, 9))
        ring.release(batch)

    recording.event(0, "info", "before the first")
    drain()
    rows = random_rows(5)
    rows["tick"] = [40, 41, 42, 43, 44]
    rows["R"] = rows["R_d"] = 0.0  # nothing to draw
    for row in rows[:4]:
        recording.tick(row, (), ())
    drain()
    recording.event(1, "info", "between two batches")
    drain()
    recording.event(2, "info", "before a row")
    recording.tick(rows[4], (), ())
    recording.event(3, "info", "behind it")
    drain()
    ring.close_fd()
    assert found == [
        (EVENTS, 0),
        *((ROWS, tick) for tick in (40, 41, 42, 43)),
        (EVENTS, 44),
        (ROWS, 44),
        (EVENTS, 44),
        (EVENTS, 45),
    ]
