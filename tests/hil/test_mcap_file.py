"""The file writer itself: its end, wherever the disk is full, as the mcap library reads it."""

from __future__ import annotations

import errno
import os
import struct
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import SeekingReader
from mcap.records import Channel, Schema
from mcap.stream_reader import StreamReader

from hil.record.mcap_file import McapFile, being_written

MESSAGES = 40


def with_chunks(path: Path, chunks: int) -> McapFile:
    file = McapFile(path, "a test")
    file.add_schema(Schema(id=1, name="none", encoding="", data=b""))
    file.add_channel(Channel(id=1, topic="/a", message_encoding="raw", metadata={}, schema_id=1))
    for k in range(chunks):
        times = np.arange(MESSAGES) + k * MESSAGES
        head = [struct.pack("<BQHIQQ", 5, 22 + 4, 1, t, t, t) + struct.pack("<I", t) for t in times.tolist()]
        offsets = np.cumsum([0, *map(len, head[:-1])])
        file.add_chunk(b"".join(head), np.ones(MESSAGES, np.int64), times, offsets)
    return file


def read(path: Path) -> tuple[list[int], int]:
    """Return the values of all messages, found by the index, and the number of chunks in it; all CRCs hold."""
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
        values = [struct.unpack("<I", message.data)[0] for _, _, message in reader.iter_messages()]
        assert summary.statistics.message_count == len(values)
        span = (summary.statistics.message_start_time, summary.statistics.message_end_time)
        assert span == (values[0], values[-1]), "the value of a message is its time"
        return values, len(summary.chunk_indexes)


def test_the_library_finds_every_message_by_the_index(tmp_path):
    file = with_chunks(tmp_path / "a.mcap", 12)
    file.add_metadata("end", {"why": "done"})
    file.finish()
    assert read(tmp_path / "a.mcap") == (list(range(12 * MESSAGES)), 12)


def test_the_head_of_a_file_names_the_library_and_no_profile(tmp_path):
    with_chunks(tmp_path / "a.mcap", 1).finish()
    with (tmp_path / "a.mcap").open("rb") as stream:
        header = SeekingReader(stream).get_header()
    assert (header.library, header.profile) == ("a test", "")


@pytest.mark.parametrize("share", np.linspace(0.0, 0.999, 9))
def test_a_disk_that_is_full_anywhere_in_the_end_keeps_the_first_chunks(share, tmp_path, monkeypatch):
    whole = with_chunks(tmp_path / "whole.mcap", 12)
    data = whole.position
    whole.add_metadata("end", {"why": "done"})
    whole.finish()
    room = data + int(share * ((tmp_path / "whole.mcap").stat().st_size - data))

    def write(fd, view):
        left = room - os.lseek(fd, 0, os.SEEK_CUR)
        if left <= 0:
            raise OSError(errno.ENOSPC, "No space left on device")
        return real(fd, bytes(view)[:left])

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


@pytest.mark.parametrize("end", [McapFile.finish, McapFile.close])
def test_a_file_is_known_to_be_written_until_its_end_however_many_look(end, tmp_path):
    path = tmp_path / "a.mcap"
    file = with_chunks(path, 2)
    with path.open("rb") as reader, path.open("rb") as other:
        assert [being_written(path) for _ in range(2)] == [True, True]
        assert reader.read() == other.read() != b"", "it can be read meanwhile"
    file.add_metadata("end", {"why": "done"})
    assert being_written(path)
    end(file)
    assert not being_written(path)


def test_a_file_that_somebody_looks_at_is_written_all_the_same(tmp_path, monkeypatch):
    """A file system may have no locks, or another process the only one."""

    def refused(fd, kind):
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr("fcntl.flock", refused)
    with_chunks(tmp_path / "a.mcap", 3).finish()
    assert read(tmp_path / "a.mcap") == (list(range(3 * MESSAGES)), 3)
    assert not being_written(tmp_path / "a.mcap")


def test_a_file_that_is_finished_is_on_the_disk_to_its_last_byte(tmp_path, monkeypatch):
    """A power failure after it loses nothing of it."""
    path, synced = tmp_path / "a.mcap", []
    monkeypatch.setattr(os, "fsync", lambda fd: synced.append(os.fstat(fd).st_size))
    file = with_chunks(path, 3)
    file.add_metadata("end", {"why": "done"})
    assert synced == []
    file.finish()
    assert synced[-1:] == [path.stat().st_size]
