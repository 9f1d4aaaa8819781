"""Logs of one frame, their index as the mcap library reads it, a summary that is damaged, a disk that is full."""

import errno
import os
import struct
from collections import defaultdict
from pathlib import Path

import pytest
from mcap.records import Chunk, Message, MessageIndex
from mcap.stream_reader import StreamReader, breakup_chunk

from drivers.errors import LogError
from drivers.protocol import Frame, Received
from hil.record.decode import Decoder
from hil.record.log import Log, Tick
from hil.record.mcap_file import McapFile
from hil.record.mcap_summary import read_summary
from tests.hil.rewrite import mcap_summary
from tests.hil.samples import assert_same, log_of, random_rows, random_ticks

TICKS = random_ticks(600, seed=8)


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return log_of(TICKS, tmp_path_factory)


def test_a_log_of_a_single_frame_gives_that_frame(tmp_path_factory):
    (row,) = random_rows(1)
    frame = Frame(0x123, b"\x01\x02\x03", 0)
    tick = Tick(row, (Received(int(row["t_ns"]) - 5, frame),), (), (), (), ())
    log = Log(log_of([tick], tmp_path_factory))
    assert [(each.id, bytes(each.data), each.t_ns) for each in log.can_frames()] == [
        (0x123, b"\x01\x02\x03", int(row["t_ns"]) - 5)
    ]


def test_frames_and_rows_of_our_own_logs_are_read_without_a_parser(path, monkeypatch):
    """Message by message it takes ten times as long."""

    def parsed(*_: object) -> None:
        raise AssertionError("a parser was asked")

    monkeypatch.setattr(Decoder, "_protobuf", parsed)
    log = Log(path)
    assert len(list(log.can_frames())) == sum(len(t.received) + len(t.sent) for t in TICKS)
    assert len(log.rows()) == len(TICKS)


def test_the_index_of_a_chunk_has_the_time_and_the_place_of_each_of_its_messages(path):
    """A viewer that looks for a time goes by it."""
    chunks = 0
    with path.open("rb") as file:
        for record in StreamReader(file, emit_chunks=True).records:
            if isinstance(record, Chunk):
                chunks += 1
                times = defaultdict(list)
                for each in breakup_chunk(record):
                    if isinstance(each, Message):
                        times[each.channel_id].append(each.log_time)
            elif isinstance(record, MessageIndex):
                entries = record.records
                assert [time for time, _ in entries] == times.pop(record.channel_id)
                assert [place for _, place in entries] == sorted({place for _, place in entries})
    assert chunks > 1
    assert not times


def test_a_damaged_record_of_the_index_is_named_with_its_place(path, tmp_path):
    """Of a channel's description a length is beyond its end; no checksum stands over it."""
    footer = struct.Struct("<QQI")
    data = bytearray(path.read_bytes())
    start, offsets, _ = footer.unpack_from(data, len(data) - 8 - footer.size)
    footer.pack_into(data, len(data) - 8 - footer.size, start, offsets, 0)
    at = start
    while data[at] != 0x04:
        at += 9 + struct.unpack_from("<Q", data, at + 1)[0]
    struct.pack_into("<I", data, at + 9 + 4, 60_000)
    bad = tmp_path / "bad.mcap"
    bad.write_bytes(data)
    with pytest.raises(LogError, match=f"damaged at byte {at}: "):
        read_summary(bad)


def test_a_log_whose_first_bytes_find_no_room_is_not_there(tmp_path, monkeypatch):
    def full(_: int, __: object) -> int:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "write", full)
    with pytest.raises(OSError, match="No space"):
        McapFile(tmp_path / "a.mcap", "x")
    assert list(Path(tmp_path).iterdir()) == []


@pytest.mark.parametrize("count", [1, 6])
def test_as_many_buses_as_there_may_be_have_their_names(tmp_path_factory, count):
    names = [f"can{k}" for k in range(count)]
    ticks = random_ticks(20)
    log = Log(log_of(ticks, tmp_path_factory, can_channel=names))
    assert list(log.can_channels) == names
    assert_same(log.ticks(), ticks)


def test_an_index_is_whole(path):
    """The library that made MCAP reads it, with its checksum."""
    assert mcap_summary(path).statistics.message_count == sum(
        read_summary(path)[0].channel_message_counts.values()
    )
