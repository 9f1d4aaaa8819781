"""Reading of records, chunks, messages and the index of a log: bounds, checksums and sizes."""

import struct
import tracemalloc
import zlib

import lz4.frame  # type: ignore[import-untyped]
import numpy as np
import pytest
import zstandard
from mcap.records import Channel, Chunk, DataEnd, Schema

from drivers.errors import LogError
from hil.record import mcap_read
from hil.record.mcap_file import MAGIC, record_bytes
from hil.record.mcap_read import MAX_CHUNK, Allowance, Record, messages_in, records
from tests.hil.rewrite import metadata, placed

MiB = 1024 * 1024


def raw(opcode, content):
    return struct.pack("<BQ", opcode, len(content)) + content


def found_in(path, *skip, cut=False):
    return [(r.opcode, r.offset, r.content, r.complete) for r in records(path, frozenset(skip), cut=cut)]


# -- where records end -----------------------------------------------------------------------------------------


def test_last_record_of_a_truncated_file_is_read_as_far_as_it_goes(tmp_path):
    """Without a complete head it is not a record."""
    last = metadata("b", k="value")
    file, starts = placed(tmp_path, metadata("a"), last)
    data = file.read_bytes()
    for there in range(len(last)):
        file.write_bytes(data[: starts[1] + there])
        assert found_in(file, cut=True)[1:] == [(0x0C, starts[1], last[9:there], False)] * (there >= 9)
        if there:
            with pytest.raises(LogError, match=f"damaged at byte {starts[1]}"):
                found_in(file)


@pytest.mark.parametrize("opcode", [0x00, 0x10, 0x80, 0xFF])
def test_reading_stops_at_unknown_bytes_and_reports_their_place(tmp_path, opcode):
    file, starts = placed(tmp_path, metadata("a"), metadata("b"), raw(opcode, b"1"), metadata("c"))
    for skip in ((), (0x0C,)):
        with pytest.raises(LogError, match=f"damaged at byte {starts[2]}: no valid record"):
            found_in(file, *skip)
    assert len(found_in(file, cut=True)) == 2


def test_no_record_is_read_after_the_end_of_the_data(tmp_path):
    for behind in (metadata("b"), b""):
        file, starts = placed(tmp_path, metadata("a"), record_bytes(DataEnd(0)), behind)
        assert [each[1] for each in found_in(file)] == starts[:1]


@pytest.mark.parametrize(
    "parts", [[], [metadata("a")], [metadata("a"), raw(0x0B, b""), metadata("b", k="v")]]
)
def test_data_checksum_covers_everything_before_the_data_end(tmp_path, parts):
    crc = zlib.crc32(MAGIC + b"".join(parts))
    file, starts = placed(tmp_path, *parts, record_bytes(DataEnd(crc)))
    assert [each[1] for each in found_in(file)] == starts[: len(parts)]
    bad, _ = placed(tmp_path, *parts, record_bytes(DataEnd(crc ^ 1)))
    with pytest.raises(LogError, match=f"before byte {starts[len(parts)]}: the checksum of the data section"):
        found_in(bad)
    if parts:
        assert found_in(bad, 0x0B, 0x0C) == [], "the checksum is not compared if kinds of records are skipped"


def test_field_beyond_its_record_and_invalid_text_are_refused():
    assert Record(4, 77, 0, channel(6, "/t")[9:]).parse().topic == "/t"
    assert Record(0x0D, 77, 0, b"").parse() is None
    for content in (b"", b"1", channel(6, "/t")[9:-1], channel(6, "/t")[9:].replace(b"/t", b"\xff\xff")):
        with pytest.raises(LogError, match=r"^damaged at byte 77: a record of kind 4 with a field"):
            Record(4, 77, 0, content).parse()


# -- sizes -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("opcode", "most"), [(0x06, 40 + 1024), (0x0C, 70), (0x01, 70)])
def test_record_above_the_size_limit_of_its_kind_is_refused(tmp_path, monkeypatch, opcode, most):
    monkeypatch.setattr(mcap_read, "MAX_CHUNK", 40)
    monkeypatch.setattr(mcap_read, "MAX_RECORD", 70)
    end = record_bytes(DataEnd(0))
    file, starts = placed(tmp_path, metadata("a"), raw(opcode, bytes(most)), metadata("b"), end)
    assert [each[1] for each in found_in(file)] == starts[:3]
    file, starts = placed(tmp_path, metadata("a"), raw(opcode, bytes(most + 1)), end)
    with pytest.raises(LogError, match=f"damaged at byte {starts[1]}: .* too long"):
        found_in(file)
    assert opcode not in {each[0] for each in found_in(file, opcode)}, "a skipped kind of record is not read"
    file, starts = placed(tmp_path, struct.pack("<BQ", opcode, 1 << 40) + b"x" * (most + 1))
    assert found_in(file, cut=True) == [(opcode, starts[0], b"x" * most, False)], "not above the size limit"


def test_attachment_above_the_size_limit_is_skipped(tmp_path, monkeypatch):
    monkeypatch.setattr(mcap_read, "MAX_RECORD", 70)
    file, starts = placed(
        tmp_path, metadata("a"), raw(0x09, bytes(71)), metadata("b"), record_bytes(DataEnd(5))
    )
    assert [each[1] for each in found_in(file)] == [starts[0], starts[2]]


def test_unpacked_size_is_limited_by_the_size_of_the_file():
    for size, most in ((0, 256 * MiB), (1000, 256 * MiB + 40_000)):
        allowance = Allowance(size)
        allowance.spend(most)
        with pytest.raises(LogError, match=f"unpacks to more than {most} bytes"):
            allowance.spend(1)


# -- chunks ----------------------------------------------------------------------------------------------------


def message(number, time, size, sequence=99):
    return raw(5, struct.pack("<HIQQ", number, sequence, time, 88) + bytes(size))


def channel(number, topic):
    return record_bytes(Channel(id=number, topic=topic, message_encoding="", metadata={}, schema_id=0))


DATA = message(3, 5, 200) + message(4, 6, 100)
PACK = {"zstd": zstandard.compress, "lz4": lz4.frame.compress, "": bytes}


SIZE = len(DATA)


def chunk(name, data, *, size=SIZE, crc=0):
    return record_bytes(
        Chunk(
            message_start_time=0, message_end_time=1, uncompressed_size=size, uncompressed_crc=crc,
            compression=name, data=data,
        )
    )[9:]  # fmt: skip


def unpacked(content, *, complete=True, allowance=None):
    length = len(content) + (not complete)
    return messages_in(Record(6, 55, length, content), allowance or Allowance(0))


def split(data, *, complete=True, allowance=None):
    """Messages of an uncompressed chunk; for a cut chunk the complete ones."""
    _, table, channels = unpacked(chunk("", data, size=len(data)), complete=complete, allowance=allowance)
    return table, channels


@pytest.mark.parametrize("name", PACK)
def test_chunk_is_unpacked_and_its_size_and_checksum_are_verified(name):
    packed = PACK[name](DATA)
    for crc in (0, zlib.crc32(DATA)):
        assert unpacked(chunk(name, packed, crc=crc))[0] == DATA
    assert unpacked(chunk(name, PACK[name](b""), size=0))[0] == b""
    wrong = [{"crc": zlib.crc32(DATA) ^ 1}, *({"size": size} for size in (0, len(DATA) - 1, len(DATA) + 1))]
    for changed in wrong:
        with pytest.raises(LogError, match=r"^damaged at byte 55: the checksum of a chunk differs"):
            unpacked(chunk(name, packed, **changed))
    if name:
        with pytest.raises(LogError, match="cannot be decompressed"):
            unpacked(chunk(name, DATA))


def test_chunk_with_an_unknown_compression_is_refused():
    with pytest.raises(LogError, match="allowed: zstd, lz4 and none"):
        unpacked(chunk("ZSTD", zstandard.compress(DATA)))


@pytest.mark.parametrize("name", ["zstd", "lz4"])
def test_chunk_above_the_unpacked_limit_is_refused_before_unpacking(name):
    bomb = PACK[name](bytes(50_000_000))
    with pytest.raises(LogError, match=f"allowed: {MAX_CHUNK}"):
        unpacked(chunk(name, bomb, size=MAX_CHUNK + 1))
    with pytest.raises(LogError, match="unpacks to more than"):
        unpacked(chunk(name, PACK[name](DATA)), allowance=Allowance(-10 * MiB))
    tracemalloc.start()
    try:
        with pytest.raises(LogError, match="checksum"):
            unpacked(chunk(name, bomb, size=1000))
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 1_000_000


@pytest.mark.parametrize("name", ["zstd", ""])
def test_truncated_chunk_gives_its_complete_messages(name):
    random = np.random.default_rng(3).bytes(200_000)  # zstd packs 128 KiB at once
    data = DATA + raw(5, struct.pack("<HIQQ", 7, 0, 7, 88) + random)
    content = chunk(name, PACK[name](data), size=len(data), crc=zlib.crc32(data))
    assert len(unpacked(content)[1].channel) == 3
    for left_out in (1, 40):
        found, table, _ = unpacked(content[:-left_out], complete=False)
        assert data.startswith(found)
        assert table.channel.tolist() == [3, 4]
    for size in range(len(chunk(name, b"")) + 1):
        assert unpacked(content[:size], complete=False)[0] == b""
    assert unpacked(chunk("zstd", DATA), complete=False)[0] == b"", "a damaged truncated chunk gives no data"


# -- messages --------------------------------------------------------------------------------------------------


def test_message_of_less_than_22_bytes_is_refused():
    for size in (0, 13, 14, 21):
        short = raw(5, bytes(size))
        for data in (message(1, 5, 0) + short, short + message(1, 5, 0)):
            with pytest.raises(LogError, match=r"less than 22 bytes|are not a record"):
                split(data)


@pytest.mark.parametrize("left", [1, 8, 9, 15, 22, 23, 30])
def test_incomplete_last_record_is_refused_unless_the_chunk_is_truncated(left):
    data = message(3, 9, 0) + message(3, 9, 0)[:left]
    with pytest.raises(LogError, match=f"the last {left} bytes of a chunk are not a record"):
        split(data)
    table, _ = split(data, complete=False)
    assert (table.offset.tolist(), table.length.tolist()) == ([0], [31])


@pytest.mark.parametrize("place", [0, 1, 2])
@pytest.mark.parametrize("time", [2**63, 2**64 - 1])
def test_time_after_the_year_2262_is_refused(place, time):
    found = [message(1, 5, 0), message(1, 6, 0)]
    found.insert(place, message(1, time, 0))
    with pytest.raises(LogError, match="2262"):
        split(b"".join(found))


def test_channels_between_messages_are_read_and_schemas_skipped():
    schema = record_bytes(Schema(id=9, name="", encoding="", data=b""))
    assert len(schema) == 23
    table, (found,) = split(schema + message(1, 5, 2) + channel(6, "/t") + message(6, 8, 0))
    assert (table.channel.tolist(), table.offset.tolist()) == ([1, 6], [23, 56 + len(channel(6, "/t"))])
    assert (found.id, found.topic) == (6, "/t")
    with pytest.raises(LogError, match="a record of kind 4 with a field"):
        split(raw(4, bytes(8) + b"\xff" * 8))


@pytest.mark.parametrize("opcode", [0, 1, 2, 6, 7, 8, 0x0C, 0x0F, 0x80])
def test_record_of_another_kind_in_a_chunk_is_refused(opcode):
    for size in (22, 50):
        with pytest.raises(LogError, match="not a message, schema or channel"):
            split(message(1, 5, 0) + raw(opcode, bytes(size)))
