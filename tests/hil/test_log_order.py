"""In which order the messages of a log lie in its file."""

from collections import defaultdict

from mcap.records import Channel, Message
from mcap.stream_reader import StreamReader

from tests.hil.samples import log_of, random_ticks


def test_the_messages_of_a_tick_lie_behind_its_row_and_before_the_next_one(tmp_path_factory):
    ticks = random_ticks(40, seed=7)
    topics: dict[int, str] = {}
    found: list[list[str]] = []
    with log_of(ticks, tmp_path_factory).open("rb") as file:
        for record in StreamReader(file).records:
            if isinstance(record, Channel):
                topics[record.id] = record.topic
            elif isinstance(record, Message):
                if topics[record.channel_id] == "/tick":
                    found.append([])
                found[-1].append(topics[record.channel_id])
    counts = [sum(topic == "/can" for topic in group) for group in found]
    assert counts == [len(tick.received) + len(tick.sent) for tick in ticks]
    assert len(set(counts)) > 1


def test_what_is_drawn_of_a_tick_lies_behind_its_frames_and_before_the_next_row(tmp_path_factory):
    ticks = random_ticks(100, seed=7)
    for tick in ticks:
        for name in ("p", "p_d", "R", "R_d"):
            tick.row[name] = 0.5
    topics: dict[int, str] = {}
    found: dict[int, list[str]] = defaultdict(list)
    order: list[int] = []
    with log_of(ticks, tmp_path_factory).open("rb") as file:
        for record in StreamReader(file).records:
            if isinstance(record, Channel):
                topics[record.id] = record.topic
            elif isinstance(record, Message):
                found[record.sequence].append(topics[record.channel_id])
                order.append(record.sequence)
    assert order == sorted(order)
    for k, tick in enumerate(ticks):
        views = ["/tf", "/tf"] if k % 33 == 0 else []
        commands = len(tick.operator) + len(tick.setpoints) + len(tick.orders)
        frames = len(tick.received) + len(tick.sent)
        assert found[k] == ["/tick", *["/can"] * frames, *["/operator"] * commands, *views]
