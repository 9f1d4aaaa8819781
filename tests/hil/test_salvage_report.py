"""What a salvage says of itself, what it keeps of a foreign file, and where records of a damaged file begin."""

import errno
import os
import struct

import pytest
from mcap.reader import make_reader
from mcap.records import (
    Attachment,
    DataEnd,
    Message,
)

from drivers.errors import LogError
from hil.record import salvage as salvaging
from hil.record.log import Log
from hil.record.mcap_file import MAGIC, McapFile, record_bytes
from hil.record.mcap_read import Record
from hil.record.salvage import Lost, salvage, surviving
from hil.record.schema import SALVAGE
from tests.hil.mcap_records import metadata, placed
from tests.hil.rewrite import mcap_summary
from tests.hil.samples import log_of, random_ticks

TICKS = random_ticks(40, seed=6)
DATA_END = record_bytes(DataEnd(data_section_crc=0))


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return log_of(TICKS, tmp_path_factory)


def message(channel=99, data=b""):
    return record_bytes(Message(channel_id=channel, log_time=1, data=data, publish_time=1, sequence=0))


def inserted(path, tmp_path, *records):
    """The log with records before its first chunk, and where the first of them begins."""
    data, at = path.read_bytes(), mcap_summary(path).chunk_indexes[0].chunk_start_offset
    file = tmp_path / "inserted.mcap"
    file.write_bytes(data[:at] + b"".join(records) + data[at:])
    return file, at


def test_the_report_names_both_files_and_counts_every_byte_that_was_read(path, tmp_path):
    report = salvage(path, tmp_path / "out.mcap")
    assert (report.path, report.out) == (path, tmp_path / "out.mcap")
    assert (report.bytes_read, report.bytes_lost) == (path.stat().st_size, 0)
    with (tmp_path / "out.mcap").open("rb") as file:
        (said,) = [m.metadata for m in make_reader(file).iter_metadata() if m.name == SALVAGE]
    assert (said["original"], said["original_bytes"]) == (path.name, str(path.stat().st_size))


def test_bytes_that_are_left_out_are_said_from_the_first_to_the_last(path, tmp_path):
    bad, at = inserted(path, tmp_path, b"\xff" * 37)
    report = salvage(bad, tmp_path / "out.mcap")
    assert report.bytes_lost == 37
    assert f"bytes {at} to {at + 37} are damaged and left out" in report.remarks
    assert report.ticks == len(TICKS)


@pytest.mark.parametrize("more", [-1, 0, 1, 7])
def test_of_many_damaged_places_the_first_are_said_and_how_many_more_there_are(path, tmp_path, more):
    places = salvaging._REMARKS + more
    bad, at = inserted(path, tmp_path, *[b"\xff" * 5 + metadata("a") * 2] * places)
    report = salvage(bad, tmp_path / "out.mcap")
    assert report.bytes_lost == 5 * places
    size = 5 + 2 * len(metadata("a"))
    starts = [at + k * size for k in range(min(places, salvaging._REMARKS))]
    said = [f"bytes {start} to {start + 5} are damaged and left out" for start in starts]
    assert report.remarks == (*said, *([f"and {more} places more"] if more > 0 else []))


def test_a_name_that_came_to_be_meanwhile_is_not_taken_and_nothing_is_said_to_be_saved(
    path, tmp_path, monkeypatch
):
    out, close = tmp_path / "out.mcap", salvaging._Salvage.close

    def slow(*given):
        out.write_bytes(b"precious")
        return close(*given)

    monkeypatch.setattr(salvaging._Salvage, "close", slow)
    with pytest.raises(LogError, match="never overwritten"):
        salvage(path, out)
    assert [each.name for each in tmp_path.iterdir()] == ["out.mcap"]
    assert out.read_bytes() == b"precious"


def test_metadata_of_other_names_come_along_and_that_of_the_run_stands_there_once(path, tmp_path):
    theirs, _ = inserted(path, tmp_path, metadata("theirs", a="1"), metadata("more", b="2"))
    salvage(theirs, tmp_path / "out.mcap")
    with path.open("rb") as file:
        before = {m.name: m.metadata for m in make_reader(file).iter_metadata()}
    with (tmp_path / "out.mcap").open("rb") as file:
        found = [(m.name, m.metadata) for m in make_reader(file).iter_metadata()]
    assert [name for name, _ in found] == ["hil", "environment", "theirs", "more", SALVAGE, "summary"]
    after = dict(found)
    assert (after["theirs"], after["more"]) == ({"a": "1"}, {"b": "2"})
    assert after["hil"] == before["hil"]
    assert after["environment"] == before["environment"]


def test_attachments_come_along_each_with_its_name_time_and_kind(path, tmp_path):
    more = record_bytes(
        Attachment(log_time=5, create_time=5, name="more.csv", media_type="text/csv", data=b"1")
    )
    theirs, _ = inserted(path, tmp_path, more)
    salvage(theirs, tmp_path / "out.mcap")

    def attached(file):
        with file.open("rb") as stream:
            return [
                (a.name, a.media_type, a.log_time, a.create_time, a.data)
                for a in make_reader(stream).iter_attachments()
            ]

    assert attached(tmp_path / "out.mcap") == [*attached(path), ("more.csv", "text/csv", 5, 5, b"1")]


def test_what_is_damaged_is_called_a_chunk_or_a_record_with_its_place(path, tmp_path):
    data = bytearray(path.read_bytes())
    summary = mcap_summary(path)
    chunk, attachment = summary.chunk_indexes[0], summary.attachment_indexes[0]
    data[attachment.offset + attachment.length - 5] ^= 1  # the last byte before its checksum
    data[chunk.chunk_start_offset + chunk.chunk_length - 3] ^= 1
    (tmp_path / "bad.mcap").write_bytes(data)
    report = salvage(tmp_path / "bad.mcap", tmp_path / "out.mcap")
    assert [remark.partition(" is damaged and left out: ")[0] for remark in report.remarks] == [
        f"the record at byte {attachment.offset}",
        f"the chunk at byte {chunk.chunk_start_offset}",
    ]
    assert report.bytes_lost == attachment.length + chunk.chunk_length


@pytest.mark.parametrize("fails", ["finish", "add_metadata", "add_compressed"])
def test_a_salvage_that_fails_leaves_no_file_open(path, tmp_path, monkeypatch, fails):
    made: list[McapFile] = []

    class Kept(McapFile):
        def __init__(self, *given):
            super().__init__(*given)
            made.append(self)

    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(salvaging, "McapFile", Kept)
    monkeypatch.setattr(Kept, fails, full)
    with pytest.raises(LogError, match="cannot be written: No space left on device"):
        salvage(path, tmp_path / "out.mcap")
    (file,) = made
    assert file._fd == -1
    assert list(tmp_path.iterdir()) == []


@pytest.fixture
def without_links(monkeypatch):
    """A file system that gives no file a second name."""

    def refused(*_):
        raise OSError(errno.EPERM, "Operation not permitted")

    monkeypatch.setattr(os, "link", refused)


def test_a_file_system_without_links_takes_the_salvaged_log_all_the_same(path, tmp_path, without_links):
    report = salvage(path, tmp_path / "out.mcap")
    assert [each.name for each in tmp_path.iterdir()] == ["out.mcap"]
    assert len(Log.open(tmp_path / "out.mcap").rows("tick")) == report.ticks == len(TICKS)


@pytest.mark.parametrize("kind", ["file", "link"])
def test_nor_is_a_name_taken_there_that_came_to_be_meanwhile(
    path, tmp_path, monkeypatch, without_links, kind
):
    out, close = tmp_path / "out.mcap", salvaging._Salvage.close

    def slow(*given):
        if kind == "file":
            out.write_bytes(b"precious")
        else:
            out.symlink_to("nowhere")
        return close(*given)

    monkeypatch.setattr(salvaging._Salvage, "close", slow)
    with pytest.raises(LogError, match="never overwritten"):
        salvage(path, out)
    assert [each.name for each in tmp_path.iterdir()] == ["out.mcap"]
    assert out.is_symlink() if kind == "link" else out.read_bytes() == b"precious"


def test_a_message_without_a_byte_of_data_is_whole(tmp_path):
    empty, more = message(), message(data=b"1")
    file, starts = placed(tmp_path, metadata("a", a="1"), b"\xff" * 9, empty, more)
    *_, lost, first, second = surviving(file)
    assert lost == Lost(starts[1], starts[2])
    assert [each[1] for each in (first, second)] == starts[2:4]


def test_a_record_as_long_as_a_footer_is_no_end(tmp_path):
    same = metadata("ab", a="1")
    assert len(same) == 9 + 20
    file, starts = placed(tmp_path, same, metadata("b", b="2"))
    assert [each[1] for each in surviving(file)] == starts[:2]


@pytest.mark.parametrize("size", [1, 5, 8])
def test_bytes_at_the_end_that_are_too_few_for_a_record_are_lost(tmp_path, size):
    file, starts = placed(tmp_path, metadata("a", a="1"), b"\x01" * size)
    assert list(surviving(file))[-1] == Lost(starts[1], starts[1] + size)


def test_the_last_record_before_the_end_of_the_data_is_whole_whatever_records_its_text_resembles(tmp_path):
    inner = (metadata("x" * 40) + metadata("y" * 40)).decode("latin-1")
    file, starts = placed(tmp_path, metadata("a", a="1"), metadata("b", b=inner), DATA_END)
    found = list(surviving(file))
    assert [each[1] for each in found] == starts[:2]
    assert all(isinstance(each, Record) and each.complete for each in found)


def test_a_damaged_length_is_none_though_it_ends_at_a_record_that_would_go_on_beyond_the_file(tmp_path):
    trap = struct.pack("<BQ", 0x0C, 0x1313)
    damaged, last = bytearray(metadata("a", a="1")), metadata("c", c="3" + trap.decode() + "3")
    file, starts = placed(tmp_path, bytes(damaged), metadata("b", b="2"), last)
    damaged[1] = starts[2] + last.index(trap) - starts[0] - 9
    file.write_bytes(MAGIC + damaged + file.read_bytes()[starts[1] :])
    lost, *whole = surviving(file)
    assert lost == Lost(starts[0], starts[1])
    assert [each[1] for each in whole] == starts[1:3]


def test_metadata_of_the_runs_name_that_describe_no_columns_are_not_those_of_the_run(path, tmp_path):
    file, _ = placed(tmp_path, metadata("hil", topic="/tick"), metadata("b"))
    with pytest.raises(LogError, match="no log of this product"):
        salvage(file, tmp_path / "out.mcap")
    data = path.read_bytes()
    at = mcap_summary(path).metadata_indexes[0].offset
    file.write_bytes(data[:at] + metadata("hil", topic="/other") + data[at:])
    report = salvage(file, tmp_path / "out.mcap")
    assert report.ticks == len(TICKS)
    assert Log.open(tmp_path / "out.mcap").topic == "/tick"
