"""The MCAP file of the recorder: its index as the mcap library reads it, and its end on a full disk."""

from __future__ import annotations

import errno
import os
import struct
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import SeekingReader
from mcap.records import Channel, Chunk, Message, MessageIndex, Schema, Statistics
from mcap.stream_reader import StreamReader, breakup_chunk

from hil.record.mcap_file import McapFile, being_written
from tests.hil.rewrite import mcap_summary

MESSAGES = 40


def add(file: McapFile, channel: int, times: list[int]) -> None:
    """Write a chunk of messages whose values are their times."""
    records = [struct.pack("<BQHIQQI", 5, 22 + 4, channel, t, t, t, t) for t in times]
    count = len(times)
    file.add_chunk(b"".join(records), np.full(count, channel), np.array(times), np.arange(count) * 35)


def with_chunks(path: Path, chunks: int) -> McapFile:
    file = McapFile(path, "a test")
    file.add(Schema(id=1, name="none", encoding="", data=b""))
    for number in (1, 2):
        file.add(Channel(number, f"/{number}", message_encoding="raw", metadata={}, schema_id=1))
    for k in range(chunks):
        add(file, 1 + k // 10, list(range(k * MESSAGES, (k + 1) * MESSAGES)))
    return file


def read(path: Path) -> tuple[list[int], int]:
    """Values of all messages, found by the index, and its number of chunks; every CRC is checked."""
    with path.open("rb") as stream:
        for _ in StreamReader(stream, validate_crcs=True).records:
            pass
        stream.seek(0)
        reader = SeekingReader(stream, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        assert summary.statistics.chunk_count == len(summary.chunk_indexes)
        assert summary.statistics.metadata_count == len(summary.metadata_indexes)
        messages = [message for _, _, message in reader.iter_messages()]
        values = [struct.unpack("<I", message.data)[0] for message in messages]
        assert summary.statistics.channel_message_counts == Counter(m.channel_id for m in messages)
        assert summary.statistics.message_count == len(values)
        span = (summary.statistics.message_start_time, summary.statistics.message_end_time)
        assert span == (values[0], values[-1]), "the value of a message is its time"
        return values, len(summary.chunk_indexes)


def full(*_: object) -> int:
    raise OSError(errno.ENOSPC, "No space left on device")


# -- the file --------------------------------------------------------------------------------------------------


def test_the_library_finds_every_message_by_the_index(tmp_path):
    file = with_chunks(tmp_path / "a.mcap", 12)
    file.add_metadata("end", {"why": "done"})
    file.finish()
    assert read(tmp_path / "a.mcap") == (list(range(12 * MESSAGES)), 12)
    with (tmp_path / "a.mcap").open("rb") as stream:
        header = SeekingReader(stream).get_header()
    assert (header.library, header.profile) == ("a test", "")


@pytest.mark.parametrize("end", [McapFile.finish, McapFile.close])
def test_a_file_counts_as_being_written_until_its_end(end, tmp_path):
    path = tmp_path / "a.mcap"
    file = with_chunks(path, 2)
    with path.open("rb") as reader:
        assert [being_written(path) for _ in range(2)] == [True, True]
        assert reader.read() != b"", "the file must be readable while it is written"
    file.add_metadata("end", {"why": "done"})
    assert being_written(path)
    end(file)
    assert not being_written(path)


def test_a_finished_file_is_flushed_to_the_disk_completely(tmp_path, monkeypatch):
    """A later power failure loses no byte of it."""
    path, synced = tmp_path / "a.mcap", []
    for name in ("fsync", "fdatasync"):
        monkeypatch.setattr(os, name, lambda fd: synced.append(os.fstat(fd).st_size))
    file = with_chunks(path, 3)
    assert synced == []
    file.sync()
    assert synced == [path.stat().st_size]
    file.add_metadata("end", {"why": "done"})
    file.finish()
    assert synced[1:] == [path.stat().st_size]


def test_an_existing_file_is_kept_and_a_discarded_file_removed(tmp_path, monkeypatch):
    path = tmp_path / "a.mcap"
    path.write_bytes(b"another one")
    with pytest.raises(FileExistsError):
        McapFile(path, "a test")
    assert path.read_bytes() == b"another one"
    with_chunks(tmp_path / "b.mcap", 1).discard()
    monkeypatch.setattr(os, "write", full)
    with pytest.raises(OSError, match="No space left on device"):
        McapFile(tmp_path / "c.mcap", "a test")
    assert list(tmp_path.iterdir()) == [path]


def test_the_index_has_times_sizes_offsets_and_counts(tmp_path):
    """Messages of a chunk are neither in time order nor in channel order."""
    file = with_chunks(tmp_path / "a.mcap", 0)
    file.add(Channel(id=300, topic="/b", message_encoding="raw", metadata={}, schema_id=1))
    for channels, times in (([300, 1, 300, 1], [420, 500, 910, 440]), ([1], [310]), ([300, 1], [330, 305])):
        records = [
            struct.pack("<BQHIQQ", 5, 22 + k, c, 0, t, t) + bytes(k)
            for k, (c, t) in enumerate(zip(channels, times, strict=True))
        ]
        offset = np.cumsum([0, *map(len, records)])[:-1]
        file.add_chunk(b"".join(records), np.array(channels), np.array(times), offset)
    file.add_metadata("one", {"k": "v"})
    file.add_attachment("a.yaml", b"a: 1\n", 11, "text/yaml")
    file.finish()
    summary = mcap_summary(tmp_path / "a.mcap")
    data, chunks = (tmp_path / "a.mcap").read_bytes(), []
    with (tmp_path / "a.mcap").open("rb") as stream:
        for record in StreamReader(stream, emit_chunks=True, validate_crcs=True).records:
            if isinstance(record, Chunk):
                chunks.append(record)
                wanted: dict[int, list[tuple[int, int]]] = {}
                at = 0
                for each in breakup_chunk(record):
                    assert isinstance(each, Message)
                    wanted.setdefault(each.channel_id, []).append((each.log_time, at))
                    at += 31 + len(each.data)
            elif isinstance(record, MessageIndex):
                assert record.records == wanted.pop(record.channel_id)
                assert (
                    data[summary.chunk_indexes[len(chunks) - 1].message_index_offsets[record.channel_id]] == 7
                )
    assert not wanted
    for chunk, index in zip(chunks, summary.chunk_indexes, strict=True):
        spans = [(x.message_start_time, x.message_end_time) for x in (chunk, index)]
        assert spans[0] == spans[1]
        assert (index.uncompressed_size, index.compressed_size) == (chunk.uncompressed_size, len(chunk.data))
    assert summary.statistics == Statistics(
        attachment_count=1, channel_count=3, channel_message_counts={1: 4, 300: 3}, chunk_count=3, message_count=7,
        message_end_time=910, message_start_time=305, metadata_count=1, schema_count=1,
    )  # fmt: skip


# -- a full disk -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("share", [0.0, 0.4, 0.8, 0.999])
def test_a_full_disk_at_the_end_of_a_file_keeps_its_first_chunks(share, tmp_path, monkeypatch):
    whole = with_chunks(tmp_path / "whole.mcap", 12)
    data = whole.position
    whole.add_metadata("end", {"why": "done"})
    whole.finish()
    room = data + int(share * ((tmp_path / "whole.mcap").stat().st_size - data))

    def write(fd, view):
        left = room - os.lseek(fd, 0, os.SEEK_CUR)
        return real(fd, bytes(view)[:left]) if left > 0 else full()

    real = os.write
    monkeypatch.setattr(os, "write", write)
    file = with_chunks(tmp_path / "a.mcap", 12)
    try:
        file.add_metadata("end", {"why": "done"})
        file.finish()
    except OSError:  # as its user does: the failure is still being handled
        file.finish_within("end", lambda: {"why": "full"})
    values, chunks = read(tmp_path / "a.mcap")
    assert 0 < chunks < 12
    assert values == list(range(chunks * MESSAGES))
    assert (tmp_path / "a.mcap").stat().st_size <= room
