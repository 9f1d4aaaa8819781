"""The records of a log as they are read: borders of the file, of a record, of a chunk and of what is allowed."""

import struct
import zlib

import lz4.frame  # type: ignore[import-untyped]
import numpy as np
import pytest
import zstandard
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, DataEnd

from drivers.errors import LogError
from hil.record import mcap_read
from hil.record.mcap_file import MAGIC, record_bytes
from hil.record.mcap_read import (
    NOTHING,
    Allowance,
    MessageTable,
    Record,
    decompress,
    decompress_part,
    longest,
    records,
    split,
)
from tests.hil.mcap_records import metadata, placed

MiB = 1024 * 1024


def raw(opcode, content):
    return struct.pack("<BQ", opcode, len(content)) + content


def found_in(path, *skip):
    return [(r.opcode, r.offset, r.content, r.complete) for r in records(path, frozenset(skip))]


# -- where records end ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("skip", [(), (0x0C,), (0x05,)])
def test_the_last_record_may_be_empty_and_end_with_the_file(tmp_path, skip):
    file, starts = placed(tmp_path, metadata("a"), raw(0x0B, b""))
    a = (0x0C, starts[0], metadata("a")[9:], True)
    wanted = [*([] if 0x0C in skip else [a]), (0x0B, starts[1], b"", True), (NOTHING, starts[2], b"", False)]
    assert found_in(file, *skip) == wanted


@pytest.mark.parametrize("left", range(9))
def test_behind_the_last_record_fewer_bytes_than_a_head_has_are_none(tmp_path, left):
    file, starts = placed(tmp_path, metadata("a"), raw(0x0B, b"")[:left])
    assert found_in(file)[1:] == [(NOTHING, starts[1], b"", False)]


def test_a_record_of_a_kind_that_is_not_wanted_is_passed_over_only_where_it_is_whole(tmp_path):
    file, starts = placed(tmp_path, metadata("a"), raw(0x0B, b"1234"))
    assert found_in(file, 0x0B)[1:] == [(NOTHING, starts[2], b"", False)]
    file.write_bytes(file.read_bytes()[:-1])
    assert found_in(file, 0x0B)[1:] == [(0x0B, starts[1], b"123", False)]


@pytest.mark.parametrize("opcode", [0x00, 0x10, 0x80, 0xFF])
def test_reading_ends_at_what_is_no_record_and_names_its_place(tmp_path, opcode):
    file, starts = placed(tmp_path, metadata("a"), metadata("b"), raw(opcode, b"1"), metadata("c"))
    for skip in ((), (0x0C,)):
        assert found_in(file, *skip)[-1] == (NOTHING, starts[2], b"", False)
    assert len(found_in(file)) == 3


def test_no_record_is_of_the_kind_that_stands_for_none():
    assert NOTHING not in {int(kind) for kind in Opcode}


def test_nothing_comes_behind_the_end_of_the_data_and_a_cut_one_is_a_record_that_is_cut(tmp_path):
    end = record_bytes(DataEnd(0))
    file, starts = placed(tmp_path, metadata("a"), end, metadata("b"))
    assert [each[1] for each in found_in(file)] == starts[:1]
    file, starts = placed(tmp_path, metadata("a"), end)
    assert [each[1] for each in found_in(file)] == starts[:1]
    file, starts = placed(tmp_path, metadata("a"), end[:-1])
    assert found_in(file)[1:] == [(0x0F, starts[1], bytes(3), False)]


# -- the checksum of the data --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "parts", [[], [metadata("a")], [metadata("a"), raw(0x0B, b""), metadata("b", k="v")]]
)
def test_the_checksum_of_the_data_stands_over_all_before_its_end(tmp_path, parts):
    crc = zlib.crc32(MAGIC + b"".join(parts))
    file, starts = placed(tmp_path, *parts, record_bytes(DataEnd(crc)))
    assert [each[1] for each in found_in(file)] == starts[: len(parts)]
    bad, _ = placed(tmp_path, *parts, record_bytes(DataEnd(crc ^ 1)))
    with pytest.raises(
        LogError,
        match=f"damaged somewhere before byte {starts[len(parts)]}: the checksum of the data section",
    ):
        found_in(bad)
    assert len(found_in(bad, 0x03)) == len(parts), "where kinds are passed over it is not compared"
    none, _ = placed(tmp_path, *parts, record_bytes(DataEnd(0)))
    assert len(found_in(none)) == len(parts), "its writer may have made none"


# -- sizes ---------------------------------------------------------------------------------------------------


def test_a_chunk_may_have_16_MiB_and_its_head_and_any_other_record_64_MiB():
    assert longest(Opcode.CHUNK) == 16 * MiB + 1024
    assert {longest(int(kind)) for kind in Opcode if kind != Opcode.CHUNK} == {64 * MiB}


@pytest.mark.parametrize(("opcode", "most"), [(0x06, 40 + 1024), (0x0C, 70), (0x01, 70)])
def test_a_record_may_be_as_large_as_its_kind_and_no_larger(tmp_path, monkeypatch, opcode, most):
    monkeypatch.setattr(mcap_read, "MAX_CHUNK", 40)
    monkeypatch.setattr(mcap_read, "MAX_RECORD", 70)
    file, starts = placed(tmp_path, metadata("a"), raw(opcode, bytes(most)), metadata("b"))
    assert [each[1] for each in found_in(file)] == starts
    file, starts = placed(tmp_path, metadata("a"), raw(opcode, bytes(most + 1)))
    with pytest.raises(
        LogError, match=f"damaged at byte {starts[1]}: a record of {most + 1} bytes, allowed: {most}$"
    ):
        found_in(file)
    assert found_in(file, opcode)[-1] == (NOTHING, starts[2], b"", False), "what is passed over is not read"


@pytest.mark.parametrize("there", [5, 70, 71, 200])
def test_of_a_record_that_reaches_past_the_end_no_more_is_read_than_its_kind_may_have(
    tmp_path, monkeypatch, there
):
    monkeypatch.setattr(mcap_read, "MAX_RECORD", 70)
    head = struct.pack("<BQ", 0x0C, 1 << 40)
    file, starts = placed(tmp_path, metadata("a"), head + b"x" * there)
    assert found_in(file)[1:] == [(0x0C, starts[1], b"x" * min(there, 70), False)]


def test_a_log_of_1000_bytes_unpacks_to_40000_beyond_256_MiB_and_has_125_messages_beyond_50000():
    allowance = Allowance(1000)
    allowance.spend(256 * MiB + 40_000)
    allowance.spend(messages=50_125)
    with pytest.raises(LogError, match=f"more than {256 * MiB + 40_000}, which no log of a run does"):
        allowance.spend(1)
    with pytest.raises(LogError, match="more than 50125 messages, which no log of a run has"):
        allowance.spend(-1, messages=1)


# -- chunks --------------------------------------------------------------------------------------------------

DATA = bytes(range(200)) + bytes(100)
PACK = {"zstd": zstandard.compress, "lz4": lz4.frame.compress, "": bytes}


def chunk(name, data, *, size=300, crc=0):
    return Chunk(
        message_start_time=0, message_end_time=1, uncompressed_size=size, uncompressed_crc=crc,
        compression=name, data=data,
    )  # fmt: skip


@pytest.mark.parametrize("name", PACK)
def test_a_chunk_unpacks_to_the_bytes_that_it_says_and_their_checksum_counts_where_there_is_one(name):
    packed = PACK[name](DATA)
    for crc in (0, zlib.crc32(DATA)):
        assert decompress(chunk(name, packed, crc=crc)) == DATA
    with pytest.raises(LogError, match="a chunk is damaged: its checksum differs"):
        decompress(chunk(name, packed, crc=zlib.crc32(DATA) ^ 1))
    for size in (0, len(DATA) - 1, len(DATA) + 1):
        with pytest.raises(LogError, match="a chunk is damaged: its checksum differs"):
            decompress(chunk(name, packed, size=size))
    assert decompress(chunk(name, PACK[name](b""), size=0)) == b""


@pytest.mark.parametrize("name", ["zstd", "lz4"])
def test_a_chunk_that_was_not_packed_by_what_it_names_cannot_be_decompressed(name):
    with pytest.raises(LogError, match="a chunk cannot be decompressed: "):
        decompress(chunk(name, DATA))


@pytest.mark.parametrize("name", ["zst", "ZSTD", "none", "\0"])
def test_a_chunk_that_is_packed_by_something_else_is_refused_by_its_name(name):
    for data in (DATA, zstandard.compress(DATA)):
        with pytest.raises(LogError) as refused:
            decompress(chunk(name, data))
        assert str(refused.value) == f"a chunk is compressed by {name!r}: allowed are zstd, lz4 and none"


def test_a_chunk_unpacks_to_its_largest_size_and_no_further(monkeypatch):
    monkeypatch.setattr(mcap_read, "MAX_CHUNK", len(DATA))
    assert decompress(chunk("", DATA)) == DATA
    monkeypatch.setattr(mcap_read, "MAX_CHUNK", len(DATA) - 1)
    with pytest.raises(LogError, match=r"^a chunk of 300 bytes: at most 299 are unpacked$"):
        decompress(chunk("", DATA))


@pytest.mark.parametrize("name", ["zstd", ""])
def test_of_the_beginning_of_a_chunk_at_most_16_MiB_are_unpacked(name):
    large = bytes(range(256)) * (16 * MiB // 256) + b"\xff" * (2 * MiB)
    content = record_bytes(chunk(name, PACK[name](large)))[9:]
    assert decompress_part(content) == large[: 16 * MiB]


@pytest.mark.parametrize("name", ["zstd", ""])
def test_the_beginning_of_a_chunk_without_a_byte_of_its_data_gives_none(name):
    head = record_bytes(chunk(name, b""))[9:]
    assert [decompress_part(head[:size]) for size in range(len(head) + 1)] == [b""] * (len(head) + 1)


def test_the_beginning_of_a_chunk_that_is_damaged_gives_nothing():
    assert decompress_part(record_bytes(chunk("zstd", DATA))[9:]) == b""
    assert decompress_part(record_bytes(chunk("", DATA))[9:]) == DATA


# -- messages ------------------------------------------------------------------------------------------------


def message(channel, time, size):
    return raw(5, struct.pack("<HIQQ", channel, 99, time, 88) + bytes(size))


def described(k, topic):
    return record_bytes(Channel(id=k, topic=topic, message_encoding="", metadata={}, schema_id=0))


def test_each_message_has_its_channel_its_time_its_place_and_its_length():
    data = message(65535, 7, 0) + message(3, 2**63 - 1, 5) + message(258, 0, 1)
    table, others = split(data)
    assert all(column.dtype == np.int64 for column in table)
    assert [column.tolist() for column in table] == [
        [65535, 3, 258], [7, 2**63 - 1, 0], [0, 31, 67], [31, 36, 32],
    ]  # fmt: skip
    assert others == []
    assert [column.tolist() for column in table.before(np.array([0, 2]))] == [
        [65535, 3],
        [7, 2**63 - 1],
        [0, 31],
        [31, 36],
    ]
    assert isinstance(table.before(np.array([1])), MessageTable)
    assert table.before(np.zeros(0, int)).channel.tolist() == []


@pytest.mark.parametrize("place", [0, 1, 2])
@pytest.mark.parametrize("time", [2**63, 2**64 - 1])
def test_a_time_after_the_year_2262_is_refused_wherever_the_message_stands(place, time):
    records = [message(1, 5, 0), message(1, 6, 0)]
    records.insert(place, message(1, time, 0))
    with pytest.raises(LogError, match=r"^a message has a time after the year 2262$"):
        split(b"".join(records))


def test_schemas_and_channels_between_messages_are_given_as_they_stand():
    schema, channel, short = raw(3, b"schema" * 9), described(6, "/t"), raw(4, b"")
    table, others = split(schema + message(1, 5, 2) + channel + short)
    at = len(schema)
    behind = at + 33 + len(channel)
    assert table.offset.tolist() == [at]
    assert others == [
        Record(3, 0, schema[9:], complete=True),
        Record(4, at + 33, channel[9:], complete=True),
        Record(4, behind, b"", complete=True),
    ]
    assert [record.whole for record in others] == [schema, channel, short]


def test_1024_schemas_and_channels_may_stand_in_a_chunk_and_no_more():
    most = raw(3, b"") * 1000 + raw(4, b"1") * 24
    assert len(split(most + message(1, 5, 0))[1]) == 1024
    for further in (3, 4):
        with pytest.raises(
            LogError, match=f"^a record of kind {further} after 1024 others: no chunk has that$"
        ):
            split(most + raw(further, b""))


@pytest.mark.parametrize("opcode", [0, 1, 2, 6, 7, 8, 0x0C, 0x0F, 0x80])
def test_a_record_of_another_kind_stands_in_no_chunk(opcode):
    for size in (0, 22, 50):
        with pytest.raises(LogError, match=f"^a record of kind {opcode} after 1 others: no chunk has that$"):
            split(raw(4, b"") + raw(opcode, bytes(size)))


def test_a_field_of_a_damaged_record_does_not_reach_past_its_end():
    assert Record(4, 77, described(6, "/t")[9:], complete=True).parse().topic == "/t"
    assert Record(0x0B + 2, 77, b"", complete=True).parse() is None
    with pytest.raises(LogError, match=r"^a field of 2 bytes reaches past the end"):
        Record(4, 77, b"1", complete=True).parse()
