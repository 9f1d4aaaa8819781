"""In which order the messages of a log lie in its file."""

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
