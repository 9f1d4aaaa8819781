import struct
import zlib

import pytest
import zstandard
from mcap.reader import make_reader
from mcap.records import Attachment, Chunk

from drivers.errors import LogError
from hil.record.log import Log
from hil.record.mcap_file import record_bytes
from hil.record.mcap_read import Record
from hil.record.salvage import Lost, salvage, surviving
from tests.hil.mcap_records import metadata, placed
from tests.hil.rewrite import mcap_summary
from tests.hil.samples import assert_same, log_of, random_ticks

COUNT = 900
TICKS = random_ticks(COUNT, seed=5)


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return log_of(TICKS, tmp_path_factory)


@pytest.fixture(scope="module")
def chunks(path):
    return mcap_summary(path).chunk_indexes


def cut(path, tmp_path, size, tail=b""):
    bad = tmp_path / "cut.mcap"
    bad.write_bytes(path.read_bytes()[:size] + tail)
    return bad


def ticks_before(path, offset):
    ends = [c.message_end_time for c in mcap_summary(path).chunk_indexes if c.chunk_start_offset < offset]
    if not ends:
        return 0
    with path.open("rb") as file:
        return sum(1 for _ in make_reader(file).iter_messages("/tick", ending_at=max(ends)))


@pytest.mark.parametrize("fraction", [0.15, 0.3, 0.5, 0.77, 0.9, 0.98])
def test_a_log_cut_anywhere_gives_every_complete_chunk_and_valid_ticks(path, chunks, tmp_path, fraction):
    size = int(path.stat().st_size * fraction)
    bad = cut(path, tmp_path, size)
    before = bad.read_bytes()
    report = salvage(bad, tmp_path / "out.mcap")
    assert bad.read_bytes() == before
    whole = [c for c in chunks if c.chunk_start_offset + c.chunk_length <= size]
    assert report.chunks == len(whole)
    least = ticks_before(path, whole[-1].chunk_start_offset + 1) if whole else 0
    assert least <= report.ticks < COUNT
    assert not report.complete
    log = Log.open(tmp_path / "out.mcap")
    assert log.summary.closed == "salvaged"
    assert log.configuration == "a: 1\n"
    assert_same(log.ticks(), TICKS[: report.ticks])
    with (tmp_path / "out.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        assert sum(1 for _ in reader.iter_messages()) == report.messages


def test_every_byte_around_the_borders_of_records_can_be_the_last(path, chunks, tmp_path):
    chunk = chunks[2]
    middle = chunk.chunk_start_offset
    sizes = [
        *range(middle - 3, middle + 60, 3),
        *range(middle + chunk.chunk_length - 20, middle + chunk.chunk_length + 40, 5),
    ]
    for size in sizes:
        bad = cut(path, tmp_path, size)
        out = tmp_path / f"{size}.mcap"
        report = salvage(bad, out)
        assert report.chunks == (3 if size >= middle + chunk.chunk_length else 2)
        assert_same(Log.open(out).ticks(), TICKS[: report.ticks])


def test_a_chunk_cut_in_its_middle_gives_the_ticks_before_the_cut(path, chunks, tmp_path):
    last = max(chunks, key=lambda c: c.chunk_length)
    size = last.chunk_start_offset + last.chunk_length - 200
    report = salvage(cut(path, tmp_path, size), tmp_path / "out.mcap")
    assert report.partial_messages > 0
    assert report.ticks > ticks_before(path, last.chunk_start_offset)
    assert_same(Log.open(tmp_path / "out.mcap").ticks(), TICKS[: report.ticks])
    assert "inside the chunk" in report.remarks[0]


@pytest.mark.parametrize("missing", [200, 2000, 6000])
def test_a_cut_chunk_gives_every_tick_that_another_one_follows_and_no_fewer(path, chunks, tmp_path, missing):
    last = max(chunks, key=lambda c: c.chunk_length)
    size = last.chunk_start_offset + last.chunk_length - missing
    content = path.read_bytes()[last.chunk_start_offset + 9 : size]
    # MCAP: start, end and uncompressed size of 8 bytes, CRC, name of the compression, size; then the records
    (name,) = struct.unpack_from("<I", content, 28)
    left = zstandard.ZstdDecompressor().decompressobj().decompress(content[32 + name + 8 :])
    (tick,) = (n for n, c in mcap_summary(path).channels.items() if c.topic == "/tick")
    at, begun = 0, 0
    while at + 9 <= len(left):
        opcode, length = struct.unpack_from("<BQ", left, at)
        at += 9 + length
        begun += opcode == 5 and at <= len(left) and struct.unpack_from("<H", left, at - length)[0] == tick
    report = salvage(cut(path, tmp_path, size), tmp_path / "out.mcap")
    assert begun > 1
    assert report.ticks == ticks_before(path, last.chunk_start_offset) + begun - 1


def test_only_the_index_missing_is_nothing_lost(path, tmp_path):
    report = salvage(cut(path, tmp_path, path.stat().st_size - 30), tmp_path / "out.mcap")
    assert (report.complete, report.ticks, report.bytes_lost) == (True, COUNT, 0)
    assert Log.open(tmp_path / "out.mcap").summary.closed == "clean"


def test_zeros_at_the_end_as_a_file_system_leaves_them_are_passed_over(path, chunks, tmp_path):
    border = chunks[1].chunk_start_offset
    report = salvage(cut(path, tmp_path, border, bytes(5000)), tmp_path / "out.mcap")
    assert report.bytes_lost == 5000
    assert report.chunks == 1
    assert_same(Log.open(tmp_path / "out.mcap").ticks(), TICKS[: report.ticks])


@pytest.mark.parametrize("damaged", [1, 2])
def test_a_damaged_chunk_is_left_out_and_said_with_its_ticks(path, chunks, tmp_path, damaged):
    content = bytearray(path.read_bytes())
    content[chunks[damaged].chunk_start_offset + chunks[damaged].chunk_length // 2] ^= 0x40
    bad = tmp_path / "bad.mcap"
    bad.write_bytes(content)
    report = salvage(bad, tmp_path / "out.mcap")
    assert report.ticks + report.ticks_lost == COUNT
    assert report.ticks_lost > 0
    assert report.chunks == len(chunks) - 1
    assert not report.complete
    assert "damaged" in report.remarks[0]
    log = Log.open(tmp_path / "out.mcap")
    assert log.summary.closed == "salvaged", "its run has closed another log"
    assert log.metadata["summary"]["ticks"] == str(report.ticks)
    assert 0 < len(list(log.ticks())) < COUNT


def message(size, time):
    """A record of so many bytes, of a channel that nothing describes."""
    return struct.pack("<BQHIQQ", 5, size - 9, 99, 0, time, time).ljust(size, b"\0")


def test_nothing_is_overwritten_and_nothing_made_of_nothing(path, tmp_path):
    out = tmp_path / "out.mcap"
    out.write_bytes(b"precious")
    with pytest.raises(LogError, match="never overwritten"):
        salvage(path, out)
    assert out.read_bytes() == b"precious"
    with pytest.raises(LogError, match="cannot be read"):
        salvage(tmp_path / "nothing.mcap", tmp_path / "b.mcap")
    with pytest.raises(LogError, match="nothing to salvage"):
        salvage(cut(path, tmp_path, 100), tmp_path / "b.mcap")
    with pytest.raises(LogError, match="not an MCAP"):
        salvage(out, tmp_path / "b.mcap")
    assert not (tmp_path / "b.mcap").exists()


def test_a_damaged_table_of_columns_is_replaced_by_that_of_this_version_and_said(path, tmp_path):
    bad = tmp_path / "bad.mcap"
    bad.write_bytes(path.read_bytes().replace(b'"type"', b'"tipe"', 1))
    report = salvage(bad, tmp_path / "out.mcap")
    assert report.ticks == len(Log(tmp_path / "out.mcap").rows("tick")) == COUNT
    assert report.remarks[0] == "the table of columns is damaged; that of this version takes its place"
    assert not report.complete


def test_a_bit_that_turned_over_where_no_record_has_a_checksum_of_its_own_is_said(path, tmp_path):
    metadata = mcap_summary(path).metadata_indexes[0]
    data = bytearray(path.read_bytes())
    data[metadata.offset + metadata.length - 1] ^= 1  # the end of its last value
    bad = tmp_path / "bit.mcap"
    bad.write_bytes(data)
    report = salvage(bad, tmp_path / "out.mcap")
    assert report.ticks == COUNT
    assert not report.complete
    assert any("checksum of the data section" in remark for remark in report.remarks), report.remarks


def test_a_last_record_that_the_file_ends_with_is_whole_whatever_records_its_text_resembles(tmp_path):
    inner = (metadata("x" * 40) + metadata("y" * 40)).decode("latin-1")
    assert inner.encode("utf-8").decode() == inner
    first, last = metadata("a", a="1"), metadata("b", b=inner)
    path, starts = placed(tmp_path, first, last)
    found = list(surviving(path))
    assert all(isinstance(each, Record) and each.complete for each in found)
    assert [each[1] for each in found] == starts[:2]


def test_a_record_that_claims_some_bytes_of_the_next_costs_itself_alone(tmp_path):
    """The next one begins before the claimed end, and ends beyond it."""
    damaged = bytearray(metadata("a", a="1"))
    damaged[1] += 20
    path, starts = placed(tmp_path, bytes(damaged), metadata("b", b="2" * 60), metadata("c", c="3"))
    lost, *whole = surviving(path)
    assert lost == Lost(starts[0], starts[1])
    assert [each[1] for each in whole] == starts[1:3]


def attachment(data, *, checked=True):
    """An attachment; its checksum, of all before it, is the last word, and may be left out as 0."""
    whole = record_bytes(Attachment(log_time=0, create_time=0, name="log", media_type="x", data=data))
    content = bytearray(whole[9:])
    content[-4:] = struct.pack("<I", zlib.crc32(content[:-4]) if checked else 0)
    return whole[:9] + bytes(content)


def unpacked(data, *, crc, spare=b"", compression=""):
    """A chunk in which the records can be read as they are, though it may have the form of a packed one."""
    content = record_bytes(
        Chunk(
            message_start_time=0, message_end_time=1, uncompressed_size=len(data), uncompressed_crc=crc,
            compression=compression, data=stored(data) if compression else data,
        )
    )[9:]  # fmt: skip
    return struct.pack("<BQ", 6, len(content) + len(spare)) + content + spare


def stored(data):
    """A frame of Zstandard with one block that is not compressed."""
    return b"\x28\xb5\x2f\xfd\x20" + bytes([len(data)]) + (len(data) << 3 | 1).to_bytes(3, "little") + data


INNER = metadata("x", x="1") + metadata("y", y="2")
JUNK = b"\xff" * 50


@pytest.mark.parametrize(
    ("outer", "whole"),
    [
        (attachment(INNER), True),
        (attachment(INNER, checked=False), False),
        (attachment(INNER)[:-1] + b"\0", False),
        (unpacked(INNER, crc=zlib.crc32(INNER)), True),
        (unpacked(INNER, crc=zlib.crc32(INNER), compression="zstd"), True),
        (unpacked(INNER, crc=0), False),
        (unpacked(INNER, crc=zlib.crc32(INNER) ^ 1), False),
        (unpacked(INNER, crc=zlib.crc32(INNER), spare=b"\0"), False),
        (unpacked(INNER, crc=zlib.crc32(INNER), spare=b"\0" * 8, compression="zstd"), False),
        (metadata("b", b=INNER.decode("latin-1")), False),
    ],
    ids=[
        "attachment",
        "no sum",
        "wrong sum",
        "chunk",
        "chunk of zstd",
        "chunk, no sum",
        "wrong",
        "spare byte",
        "spare bytes",
        "no sum by kind",
    ],
)
def test_before_damage_a_record_that_holds_records_is_whole_where_its_own_checksum_says_so(
    tmp_path, outer, whole
):
    first = metadata("a", a="1")
    path, starts = placed(tmp_path, first, outer, JUNK, metadata("c", c="3"), metadata("d", d="4"))
    found = list(surviving(path))
    records = [each for each in found if isinstance(each, Record)]
    assert records[0].offset == starts[0]
    if whole:
        assert (records[1].offset, records[1].whole) == (starts[1], outer)
        assert found[2] == Lost(starts[2], starts[3])
    else:
        inside = starts[1] + outer.index(INNER)
        assert found[1] == Lost(starts[1], inside)
        assert records[1].offset == inside
    assert [each.offset for each in records[-2:]] == starts[3:5]


@pytest.mark.parametrize("behind", [0, 300])
@pytest.mark.parametrize("compression", ["", "zstd"])
def test_the_bytes_of_a_cut_chunk_whose_rest_is_damaged_are_lost_once(
    path, chunks, tmp_path, compression, behind
):
    """A message of 5 bytes is none; the chunk says that it is longer than what is left of it."""
    first = chunks[0].chunk_start_offset + chunks[0].chunk_length
    records = struct.pack("<BQ", 5, 5) + bytes(5 + behind)
    if compression:
        records = zstandard.ZstdCompressor().compress(records)
    name = compression.encode()
    content = struct.pack("<QQQII", 0, 0, 5000, 0, len(name)) + name + struct.pack("<Q", 5000) + records
    tail = struct.pack("<BQ", 6, len(content) + 1000) + content
    bad = cut(path, tmp_path, first, tail)
    report = salvage(bad, tmp_path / "out.mcap")
    assert any("is damaged and left out" in remark for remark in report.remarks)
    assert report.bytes_lost == len(tail)
    assert report.bytes_lost < report.bytes_read
    assert Log.open(tmp_path / "out.mcap").metadata["salvage"]["bytes_lost"] == str(len(tail))
