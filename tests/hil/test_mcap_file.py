"""The file writer itself: its end, wherever the disk is full, as the mcap library reads it."""

from __future__ import annotations

import errno
import os
import struct
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import SeekingReader
from mcap.records import Channel, Chunk, Schema
from mcap.stream_reader import StreamReader

from hil.record.mcap_file import MAGIC, McapFile, being_written

MESSAGES = 40


def add(file: McapFile, channel: int, times: list[int]) -> None:
    """Write a chunk of messages whose values are their times."""
    records = [struct.pack("<BQHIQQI", 5, 22 + 4, channel, t, t, t, t) for t in times]
    count = len(times)
    file.add_chunk(b"".join(records), np.full(count, channel), np.array(times), np.arange(count) * 35)


def with_chunks(path: Path, chunks: int) -> McapFile:
    file = McapFile(path, "a test")
    file.add_schema(Schema(id=1, name="none", encoding="", data=b""))
    file.add_channel(Channel(id=1, topic="/a", message_encoding="raw", metadata={}, schema_id=1))
    for k in range(chunks):
        add(file, 1, list(range(k * MESSAGES, (k + 1) * MESSAGES)))
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


# -- the descriptor ------------------------------------------------------------------------------------------


def held(path):
    """Return how many descriptors of a file this process has, be the file there or gone."""
    links = [str(fd.readlink()) for fd in Path("/proc/self/fd").iterdir() if fd.is_symlink()]
    assert len(links) > 2
    return sum(link.removesuffix(" (deleted)") == str(path) for link in links)


def test_a_look_whether_a_file_is_written_leaves_nothing_open(tmp_path):
    idle = tmp_path / "idle.mcap"
    idle.write_bytes(b"x")
    assert (being_written(idle), held(idle)) == (False, 0)
    file = McapFile(tmp_path / "a.mcap", "a test")
    assert [(being_written(file.path), held(file.path)) for _ in range(2)] == [(True, 1)] * 2
    file.close()


def test_a_look_at_a_pipe_does_not_wait_for_its_other_end(tmp_path, monkeypatch):
    real, given = os.open, []

    def opened(path, flags):
        given.append(flags & os.O_NONBLOCK)
        return real(path, flags | os.O_NONBLOCK)

    os.mkfifo(tmp_path / "pipe")
    monkeypatch.setattr(os, "open", opened)
    assert not being_written(tmp_path / "pipe")
    assert given == [os.O_NONBLOCK]


@pytest.mark.parametrize("end", [McapFile.finish, McapFile.close])
def test_a_file_is_open_until_its_end(end, tmp_path):
    file = with_chunks(tmp_path / "a.mcap", 1)
    assert held(file.path) == 1
    end(file)
    assert held(file.path) == 0


@pytest.mark.parametrize("number", [0, 1, 7])
def test_each_descriptor_is_closed_once_the_lowest_one_as_well(number, tmp_path, monkeypatch):
    """Where standard input is closed the system gives 0; a number that is closed twice may be of another file."""
    closed: list[int] = []
    file = with_chunks(tmp_path / "a.mcap", 1)
    file.close()
    monkeypatch.setattr(file, "_fd", number)
    with monkeypatch.context() as patched:
        patched.setattr(os, "close", closed.append)
        for _ in range(3):
            file.close()
    assert closed == [number]


def test_a_file_that_is_discarded_is_closed_and_gone(tmp_path):
    file = with_chunks(tmp_path / "a.mcap", 1)
    assert held(file.path) == 1
    file.discard()
    assert held(file.path) == 0
    assert list(tmp_path.iterdir()) == []


def test_a_file_whose_first_bytes_find_no_room_is_closed_and_gone(tmp_path, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "write", full)
    with pytest.raises(OSError, match="No space left on device"):
        McapFile(tmp_path / "a.mcap", "a test")
    assert held(tmp_path / "a.mcap") == 0
    assert list(tmp_path.iterdir()) == []


def test_a_file_that_exists_is_never_overwritten(tmp_path):
    path = tmp_path / "a.mcap"
    path.write_bytes(b"another one")
    with pytest.raises(FileExistsError):
        McapFile(path, "a test")
    assert path.read_bytes() == b"another one"


@pytest.mark.parametrize(("umask", "mode"), [(0, 0o666), (0o027, 0o640)])
def test_a_file_may_be_read_and_written_by_those_whom_the_umask_leaves(umask, mode, tmp_path):
    before = os.umask(umask)
    try:
        file = with_chunks(tmp_path / "a.mcap", 1)
    finally:
        os.umask(before)
    file.close()
    assert file.path.stat().st_mode & 0o7777 == mode


@pytest.mark.parametrize(("there", "synced"), [(True, "fdatasync"), (False, "fsync")])
def test_what_was_written_is_put_onto_the_disk_when_asked_by_the_shorter_way_where_there_is_one(
    there, synced, tmp_path, monkeypatch
):
    calls = []
    file = with_chunks(tmp_path / "a.mcap", 1)
    for name in ("fdatasync", "fsync"):
        monkeypatch.setattr(os, name, lambda fd, name=name: calls.append((name, os.fstat(fd).st_size)), False)
    if not there:
        monkeypatch.delattr(os, "fdatasync")
    file.sync()
    assert calls == [(synced, file.path.stat().st_size)]
    file.close()


def test_messages_are_counted_by_channel_and_of_one_that_has_none_there_are_none(tmp_path):
    file = with_chunks(tmp_path / "a.mcap", 0)
    assert (file.messages, file.messages_of(1), file.messages_of(0)) == (0, 0, 0)
    file.add_chunk(b"", np.array([1, 9, 9, 1, 9]), np.arange(5), np.arange(5))
    add(file, 9, [8, 9])
    assert (file.messages, file.messages_of(1), file.messages_of(9), file.messages_of(2)) == (7, 2, 5, 0)
    file.close()


# -- a full disk ---------------------------------------------------------------------------------------------


def test_without_a_chunk_a_full_disk_takes_nothing_back(tmp_path):
    file = with_chunks(tmp_path / "a.mcap", 0)
    before = file.path.read_bytes()
    file.finish_within("end", lambda: pytest.fail("there is nothing to say of the end"))
    assert file.path.read_bytes() == before
    assert held(file.path) == 1
    file.close()


def test_a_full_disk_takes_back_256_chunks_at_most(tmp_path, monkeypatch):
    """What is known of their places stays in memory."""
    file, asked = with_chunks(tmp_path / "a.mcap", 260), []

    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    def end():
        asked.append(file.messages)
        return {}

    monkeypatch.setattr(os, "write", full)
    with pytest.raises(OSError, match="No space left on device"):
        file.finish_within("end", end)
    assert asked == [k * MESSAGES for k in reversed(range(4, 260))]
    file.close()


@pytest.mark.parametrize("failures", [0, 1, 2])
def test_a_file_that_was_taken_back_says_of_itself_what_was_true_before(failures, tmp_path, monkeypatch):
    """Of each chunk taken back the times, the messages of its channels and all that came behind it are gone."""
    file = with_chunks(tmp_path / "a.mcap", 1)
    file.add_attachment("a", b"123", 7, "text/plain")
    for k, (channel, times) in enumerate([(5, [90, 91]), (6, [3]), (5, [99, 100, 101])]):
        add(file, channel, times)
        file.add_metadata(f"behind {k}", {})
        file.add_schema(Schema(id=2 + k, name="none", encoding="", data=b""))
        file.add_channel(Channel(id=5 + k, topic=f"/{k}", message_encoding="", metadata={}, schema_id=1))
        file.add_attachment(f"behind {k}", bytes(k), 5, "")
    real, left = os.write, [failures]

    def write(fd, view):
        if left[0] and bytes(view[-8:]) == MAGIC:
            left[0] -= 1
            raise OSError(errno.ENOSPC, "No space left on device")
        return real(fd, view)

    monkeypatch.setattr(os, "write", write)
    file.finish_within("end", lambda: {"messages": str(file.messages)})
    kept = 3 - failures - 1
    with file.path.open("rb") as stream:
        for _ in StreamReader(stream, validate_crcs=True).records:
            pass
        stream.seek(0)
        reader = SeekingReader(stream, validate_crcs=True)
        summary = reader.get_summary()
        metadata = [(each.name, each.metadata) for each in reader.iter_metadata()]
        attachments = [each.name for each in reader.iter_attachments()]
    assert summary is not None
    found = summary.statistics
    assert found is not None
    counts = [{1: MESSAGES}, {1: MESSAGES, 5: 2}, {1: MESSAGES, 5: 2, 6: 1}][kept]
    assert found.channel_message_counts == counts
    assert (found.message_start_time, found.message_end_time) == (0, [39, 91, 91][kept])
    assert (found.chunk_count, found.attachment_count, found.metadata_count) == (1 + kept, 1 + kept, 1 + kept)
    assert (found.schema_count, found.channel_count) == (1 + kept, 1 + kept)
    behind = [f"behind {k}" for k in range(kept)]
    assert metadata == [*((name, {}) for name in behind), ("end", {"messages": str(found.message_count)})]
    assert attachments == ["a", *behind]
    assert (len(summary.chunk_indexes), sorted(summary.schemas)) == (1 + kept, list(range(1, 2 + kept)))
    assert sorted(summary.channels) == [1, *range(5, 5 + kept)]


def test_a_chunk_without_a_message_says_nothing_of_when_a_log_begins_and_ends(tmp_path):
    file = McapFile(tmp_path / "a.mcap", "a test")
    file.add_schema(Schema(id=1, name="none", encoding="", data=b""))
    file.add_channel(Channel(id=1, topic="/a", message_encoding="raw", metadata={}, schema_id=1))
    nothing = Chunk(
        compression="", data=b"", message_start_time=0, message_end_time=1 << 62, uncompressed_crc=0,
        uncompressed_size=0,
    )  # fmt: skip
    none = np.zeros(0, np.int64)
    file.add_compressed(nothing, none, none, none)
    add(file, 1, [500, 600])
    file.add_compressed(nothing, none, none, none)
    file.finish()
    assert read(tmp_path / "a.mcap") == ([500, 600], 3)


@pytest.mark.parametrize("data", [b"", b"a: 1", bytes(range(256)) * 40], ids=len)
def test_the_index_says_how_large_an_attachment_is_and_where_it_stands(tmp_path, data):
    file = with_chunks(tmp_path / "a.mcap", 1)
    file.add_attachment("a.yaml", data, 77, "application/yaml")
    file.finish()
    with (tmp_path / "a.mcap").open("rb") as stream:
        reader = SeekingReader(stream)
        summary = reader.get_summary()
        assert summary is not None
        (index,) = summary.attachment_indexes
        (found,) = reader.iter_attachments()
    assert (index.name, index.data_size, index.log_time) == ("a.yaml", len(data), 77)
    assert (found.data, found.media_type, found.create_time) == (data, "application/yaml", 77)
