"""Salvage of a truncated or damaged log: recovered content, counted losses, and entries of the new log."""

import pytest
from mcap.reader import make_reader
from mcap.records import Attachment, MessageIndex

from drivers.errors import LogError
from hil.record.log import Log
from hil.record.mcap_file import MAGIC, McapFile, record_bytes
from hil.record.salvage import salvage
from hil.record.schema import CLEAN, DISK_FULL, PRODUCER_DIED, SALVAGE
from tests.hil.rewrite import mcap_summary, metadata, placed
from tests.hil.samples import assert_same, log_of, random_ticks

COUNT = 900
TICKS = random_ticks(COUNT, seed=5)


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return log_of(TICKS, tmp_path_factory)


@pytest.fixture(scope="module")
def chunks(path):
    return mcap_summary(path).chunk_indexes


@pytest.fixture
def out(tmp_path):
    return tmp_path / "out.mcap"


def cut(path, tmp_path, size, tail=b""):
    bad = tmp_path / "cut.mcap"
    bad.write_bytes(path.read_bytes()[:size] + tail)
    return bad


def flipped(path, tmp_path, *places):
    content = bytearray(path.read_bytes())
    for at in places:
        content[at] ^= 0x40
    (tmp_path / "bad.mcap").write_bytes(content)
    return tmp_path / "bad.mcap"


def inserted(path, tmp_path, *records, at=None):
    """Log with bytes inserted before its first chunk, or at an offset, and that offset."""
    data = path.read_bytes()
    at = mcap_summary(path).chunk_indexes[0].chunk_start_offset if at is None else at
    file = tmp_path / "inserted.mcap"
    file.write_bytes(data[:at] + b"".join(records) + data[at:])
    return file, at


def ticks_before(path, offset):
    ends = [c.message_end_time for c in mcap_summary(path).chunk_indexes if c.chunk_start_offset < offset]
    if not ends:
        return 0
    with path.open("rb") as file:
        return sum(1 for _ in make_reader(file).iter_messages("/tick", ending_at=max(ends)))


# -- cut -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("fraction", [0.15, 0.5, 0.9])
def test_a_log_truncated_anywhere_keeps_every_whole_chunk(path, chunks, tmp_path, out, fraction):
    size = int(path.stat().st_size * fraction)
    bad = cut(path, tmp_path, size)
    before = bad.read_bytes()
    report = salvage(bad, out)
    assert bad.read_bytes() == before
    whole = [c for c in chunks if c.chunk_start_offset + c.chunk_length <= size]
    least = ticks_before(path, whole[-1].chunk_start_offset + 1) if whole else 0
    assert least <= report.ticks < COUNT
    log = Log.open(out)
    assert log.summary.closed == "salvaged"
    assert log.configuration == "a: 1\n"
    assert_same(log.ticks(), TICKS[: report.ticks])
    with out.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        assert sum(1 for _ in reader.iter_messages("/tick")) == report.ticks


def test_a_log_may_be_truncated_at_any_byte_near_a_record_border(path, chunks, tmp_path):
    middle, end = chunks[2].chunk_start_offset, chunks[2].chunk_start_offset + chunks[2].chunk_length
    two, three = ticks_before(path, middle), ticks_before(path, end)
    for size in [*range(middle - 3, middle + 60, 3), *range(end - 20, end + 40, 5)]:
        bad = cut(path, tmp_path, size)
        out = tmp_path / f"{size}.mcap"
        report = salvage(bad, out)
        assert (report.ticks == three) == (size >= end)
        assert len(mcap_summary(out).chunk_indexes) == (2 if report.ticks == two else 3)
        assert_same(Log.open(out).ticks(), TICKS[: report.ticks])
        if middle < size < end:
            assert report.bytes_lost == size - middle
            assert Log.open(out).metadata[SALVAGE]["bytes_lost"] == str(size - middle)


def test_a_log_without_its_index_loses_nothing(path, tmp_path, out):
    report = salvage(cut(path, tmp_path, path.stat().st_size - 30), out)
    assert (report.ticks, report.bytes_lost, report.remarks) == (COUNT, 0, ())
    assert Log.open(out).summary.closed == CLEAN


def test_zeros_at_the_end_of_a_log_are_skipped(path, chunks, tmp_path, out):
    report = salvage(cut(path, tmp_path, chunks[1].chunk_start_offset, bytes(5000)), out)
    assert report.bytes_lost == 5000
    assert len(mcap_summary(out).chunk_indexes) == 1
    assert_same(Log.open(out).ticks(), TICKS[: report.ticks])


# -- damaged ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("damaged", [1, 2])
def test_a_damaged_chunk_is_left_out_and_its_ticks_are_counted(path, chunks, tmp_path, out, damaged):
    chunk = chunks[damaged]
    report = salvage(flipped(path, tmp_path, chunk.chunk_start_offset + chunk.chunk_length // 2), out)
    assert report.ticks + report.ticks_lost == COUNT
    assert report.ticks_lost > 0
    assert report.bytes_lost == chunk.chunk_length
    log = Log.open(out)
    assert log.summary.closed == "salvaged", "a salvaged log was not closed by its run"
    assert log.metadata["summary"]["ticks"] == str(report.ticks)
    assert log.metadata[SALVAGE]["ticks_lost"] == str(report.ticks_lost)
    assert len(list(log.ticks())) == report.ticks


def test_damage_is_reported_with_its_offset(path, chunks, tmp_path, out):
    attachment, chunk = mcap_summary(path).attachment_indexes[0], chunks[0]
    checked = attachment.offset + attachment.length - 5  # the last byte before its checksum
    bad = flipped(path, tmp_path, checked, chunk.chunk_start_offset + chunk.chunk_length - 3)
    report = salvage(bad, out)
    assert [": ".join(remark.split(": ")[:2]) for remark in report.remarks] == [
        f"left out: damaged at byte {attachment.offset}",
        f"left out: damaged at byte {chunk.chunk_start_offset}",
    ]
    assert report.bytes_lost == attachment.length + chunk.chunk_length


def test_a_damaged_table_of_columns_is_refused(path, tmp_path, out):
    bad = tmp_path / "bad.mcap"
    bad.write_bytes(path.read_bytes().replace(b'"type"', b'"tipe"', 1))
    with pytest.raises(LogError, match="the description of its run is damaged"):
        salvage(bad, out)
    assert not out.exists()


def test_a_flipped_bit_outside_the_chunks_is_reported(path, tmp_path, out):
    index = mcap_summary(path).metadata_indexes[0]
    report = salvage(flipped(path, tmp_path, index.offset + index.length - 1), out)
    assert report.ticks == COUNT
    assert any("checksum of the data section" in remark for remark in report.remarks), report.remarks


BROKEN = record_bytes(Attachment(log_time=0, create_time=0, name="x", media_type="", data=b"1"))[:-1] + b"?"
"""An attachment with a wrong checksum."""


@pytest.mark.parametrize("places", [20, 21, 27])
def test_at_most_20_damaged_places_are_listed_and_the_rest_is_counted(path, tmp_path, out, places):
    bad, at = inserted(path, tmp_path, *[BROKEN] * places)
    report = salvage(bad, out)
    assert (report.bytes_lost, report.ticks) == (len(BROKEN) * places, COUNT)
    more = (f"and {places - 20} more places",) if places > 20 else ()
    assert report.remarks[20:] == more
    assert all(f"damaged at byte {at + k * len(BROKEN)}" in report.remarks[k] for k in range(20))
    log = Log.open(out)
    assert log.metadata[SALVAGE]["remarks"] == "; ".join(report.remarks)
    assert log.summary.closed == "salvaged"


@pytest.mark.parametrize("kind", ["unknown kind", "length"])
@pytest.mark.parametrize("record", ["header", "attachment", "index"])
def test_a_damaged_record_header_loses_bytes_up_to_the_next_chunk(path, chunks, tmp_path, out, kind, record):
    first, second = (chunk.chunk_start_offset for chunk in chunks[:2])
    attachment = mcap_summary(path).attachment_indexes[0].offset
    start, stop = {
        "header": (len(MAGIC), mcap_summary(path).metadata_indexes[0].offset),
        "attachment": (attachment, first),
        "index": (first + chunks[0].chunk_length, second),
    }[record]
    report = salvage(flipped(path, tmp_path, start + (kind == "length")), out)
    assert (report.ticks, report.bytes_lost) == (COUNT, stop - start)
    assert report.remarks == (f"bytes {start} to {stop} are damaged and left out",)
    assert_same(Log.open(out).ticks(), TICKS)


@pytest.mark.parametrize("crc", [True, False])
def test_chunk_after_damage_is_kept_if_its_checksum_is_correct(path, chunks, tmp_path, out, crc):
    """A damaged chunk in between is skipped."""
    data, first, second = path.read_bytes(), *(chunk.chunk_start_offset for chunk in chunks[:2])
    bad = bytearray(data[first : first + chunks[0].chunk_length])
    if not crc:
        bad[-3] ^= 0x40
    (tmp_path / "bad.mcap").write_bytes(data[:first] + b"\xff" * 50 + bad + data[second:])
    report = salvage(tmp_path / "bad.mcap", out)
    assert len(mcap_summary(out).chunk_indexes) == len(chunks) - (not crc)
    assert report.bytes_lost == (50 if crc else 50 + len(bad))


@pytest.mark.parametrize("closed", [PRODUCER_DIED, DISK_FULL])
def test_a_damaged_log_keeps_the_reason_why_it_was_closed(path, tmp_path, out, closed):
    at = mcap_summary(path).metadata_indexes[-1].offset
    end = BROKEN + metadata("summary", closed=closed, ticks=str(COUNT))
    salvage(cut(path, tmp_path, at, end), out)
    assert Log.open(out).summary.closed == closed


# -- what comes along ------------------------------------------------------------------------------------------


def test_the_new_log_contains_the_name_and_size_of_the_original(path, out):
    assert salvage(path, out).bytes_lost == 0
    entry = Log.open(out).metadata[SALVAGE]
    assert (entry["original"], entry["original_bytes"]) == (path.name, str(path.stat().st_size))


def test_metadata_and_attachments_are_copied_and_the_runs_only_once(path, tmp_path, out):
    more = Attachment(log_time=5, create_time=5, name="more.csv", media_type="text/csv", data=b"1")
    foreign = metadata("theirs", a="1"), metadata("hil", topic="/other"), record_bytes(more)
    salvage(inserted(path, tmp_path, *foreign, at=mcap_summary(path).metadata_indexes[1].offset)[0], out)

    def entries(file):
        with file.open("rb") as stream:
            reader = make_reader(stream)
            found = [(m.name, m.metadata) for m in reader.iter_metadata()]
            return found, [
                (a.name, a.media_type, a.log_time, a.create_time, a.data) for a in reader.iter_attachments()
            ]

    (before, attached), (after, kept) = entries(path), entries(out)
    assert [name for name, _ in after] == ["hil", "theirs", "environment", SALVAGE, "summary"]
    assert dict(after)["theirs"] == {"a": "1"}
    assert [dict(after)[name] for name in ("hil", "environment")] == [
        dict(before)[n] for n in ("hil", "environment")
    ]
    assert kept == [("more.csv", "text/csv", 5, 5, b"1"), *attached]


def test_a_log_that_begins_with_a_message_index_loses_nothing(path, tmp_path, out):
    index = record_bytes(MessageIndex(channel_id=1, records=[(1, 2)]))
    report = salvage(inserted(path, tmp_path, index, at=len(MAGIC))[0], out)
    assert (report.ticks, report.ticks_lost, report.bytes_lost) == (COUNT, 0, 0)


def test_existing_files_are_kept_and_unusable_sources_are_refused(path, tmp_path, out):
    out.write_bytes(b"precious")
    with pytest.raises(LogError, match="never overwritten"):
        salvage(path, out)
    assert out.read_bytes() == b"precious"
    foreign, _ = placed(tmp_path, metadata("hil", topic="/tick"), metadata("b"))
    for source, word in [
        (tmp_path / "nothing.mcap", "cannot be read"),
        (cut(path, tmp_path, 100), "nothing to salvage"),
        (out, "not an MCAP"),
        (foreign, "not a log of this product"),
    ]:
        with pytest.raises(LogError, match=word):
            salvage(source, tmp_path / "b.mcap")
    assert not (tmp_path / "b.mcap").exists()


@pytest.mark.parametrize("fails", ["finish", "add_metadata", "add_chunk"])
def test_a_salvage_on_a_full_disk_leaves_no_file(path, tmp_path, out, monkeypatch, fails):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(McapFile, fails, full)
    with pytest.raises(LogError, match=r"out\.mcap: cannot be written: No space left"):
        salvage(path, out)
    assert list(tmp_path.iterdir()) == []
