"""Logs of one frame, their index as the mcap library reads it, a summary that is damaged, a disk that is full."""

import errno
import os
import random
import struct
from collections import defaultdict
from pathlib import Path

import pytest
import zstandard
from mcap.records import Chunk, Message, MessageIndex
from mcap.stream_reader import StreamReader, breakup_chunk

from drivers.errors import LogError
from drivers.protocol import Frame, Received
from hil.record.log import Log, Tick
from hil.record.mcap_file import McapFile, record_bytes
from hil.record.mcap_read import (
    FREE_BYTES,
    FREE_MESSAGES,
    LEAST_BYTES,
    MAX_RATIO,
    Allowance,
    decompress_part,
    read_summary,
)
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


@pytest.mark.parametrize("size", [0, 8, 10_000_000])
def test_a_log_may_unpack_to_so_much_more_for_each_byte_of_its_file_and_to_no_more(size):
    most, count = FREE_BYTES + MAX_RATIO * size, FREE_MESSAGES + size // LEAST_BYTES
    allowance = Allowance(size)
    for part in (most // 2, most - most // 2, 0):
        allowance.spend(part)
    for part in (count // 2, count - count // 2, 0):
        allowance.spend(messages=part)
    with pytest.raises(LogError, match=f"has {size} bytes and unpacks to more than {most},"):
        allowance.spend(1)
    with pytest.raises(LogError, match=f"has {size} bytes and more than {count} messages,"):
        allowance.spend(-1, messages=1)


UNPACKED = random.Random(3).randbytes(500) + bytes(3_000_000)


def chunk_of(data, name):
    """The content of a chunk that says by which name its records, UNPACKED, are compressed."""
    chunk = Chunk(
        message_start_time=0, message_end_time=1, uncompressed_size=len(UNPACKED), uncompressed_crc=0,
        compression=name, data=data,
    )  # fmt: skip
    return record_bytes(chunk)[9:]


@pytest.mark.parametrize("left_out", [0, 1, 40])
def test_of_the_beginning_of_a_chunk_there_is_what_it_unpacks_to(left_out):
    plain = chunk_of(UNPACKED, "")
    assert decompress_part(plain[: len(plain) - left_out]) == UNPACKED[: len(UNPACKED) - left_out]
    packed = chunk_of(zstandard.compress(UNPACKED), "zstd")
    found = decompress_part(packed[: len(packed) - left_out])
    assert UNPACKED.startswith(found)
    assert len(found) >= (500 if left_out else len(UNPACKED))


@pytest.mark.parametrize("name", ["lz4", "zst", "ZSTD"])
def test_the_beginning_of_a_chunk_of_another_kind_gives_nothing_whatever_is_in_it(name):
    assert decompress_part(chunk_of(zstandard.compress(UNPACKED), name)) == b""
    assert decompress_part(chunk_of(UNPACKED, name)) == b""


@pytest.mark.parametrize("size", [0, 31, 32, 39, 40, 43, 44])
def test_a_chunk_that_is_cut_before_its_first_record_gives_none(size):
    content = struct.pack("<QQQII", 0, 1, 500, 0, 4) + b"zstd" + struct.pack("<Q", 500)
    assert len(content) == 44
    assert decompress_part(content[:size]) == b""


def test_of_many_names_that_are_near_to_a_wrong_one_three_are_said(path):
    with pytest.raises(LogError) as refused:
        Log(path).frame("tau.leg_6")
    near = str(refused.value).partition("did you mean ")[2].rstrip("?").split(", ")
    assert len(near) == 3
    assert set(near) <= {f"tau.leg_{k}" for k in range(6)}
