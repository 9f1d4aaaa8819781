"""Records, chunks, messages and the index of a log as they are read: their borders, checksums and sizes."""

import struct
import tracemalloc
import zlib

import lz4.frame  # type: ignore[import-untyped]
import numpy as np
import pytest
import zstandard
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, DataEnd, Schema, Statistics

from drivers.errors import LogError
from hil.record import mcap_read
from hil.record.mcap_file import MAGIC, record_bytes
from hil.record.mcap_read import (
    MAX_CHUNK,
    NOTHING,
    Allowance,
    Record,
    decompress,
    decompress_part,
    longest,
    read_summary,
    records,
    split,
)
from tests.hil.mcap_records import metadata, placed

MiB = 1024 * 1024


def raw(opcode, content):
    return struct.pack("<BQ", opcode, len(content)) + content


def found_in(path, *skip):
    return [(r.opcode, r.offset, r.content, r.complete) for r in records(path, frozenset(skip))]


# -- where records end -----------------------------------------------------------------------------------------


def test_a_cut_record_is_given_as_far_as_it_goes(tmp_path):
    """Fewer bytes than a head has are no record."""
    last = metadata("b", k="value")
    file, starts = placed(tmp_path, metadata("a"), last)
    data = file.read_bytes()
    for there in range(len(last)):
        file.write_bytes(data[: starts[1] + there])
        opcode = 0x0C if there >= 9 else NOTHING
        assert found_in(file)[1:] == [(opcode, starts[1], last[9:there], False)]
    assert found_in(file, 0x0C)[-1] == (0x0C, starts[1], last[9:-1], False), (
        "also where the kind is passed over"
    )


@pytest.mark.parametrize("opcode", [0x00, 0x10, 0x80, 0xFF])
def test_reading_ends_at_unknown_bytes_and_gives_their_place(tmp_path, opcode):
    assert NOTHING not in {int(kind) for kind in Opcode}
    file, starts = placed(tmp_path, metadata("a"), metadata("b"), raw(opcode, b"1"), metadata("c"))
    for skip in ((), (0x0C,)):
        assert found_in(file, *skip)[-1] == (NOTHING, starts[2], b"", False)
    assert len(found_in(file)) == 3


def test_nothing_comes_behind_the_end_of_the_data(tmp_path):
    end = record_bytes(DataEnd(0))
    for behind in (metadata("b"), b""):
        file, starts = placed(tmp_path, metadata("a"), end, behind)
        assert [each[1] for each in found_in(file)] == starts[:1]
    file, starts = placed(tmp_path, metadata("a"), end[:-1])
    assert found_in(file)[1:] == [(0x0F, starts[1], bytes(3), False)]
    for length in (0, 3, 5):
        file, starts = placed(tmp_path, metadata("a"), raw(0x0F, bytes(length)))
        with pytest.raises(LogError, match=f"damaged at byte {starts[1]}: the end of the data"):
            found_in(file)


@pytest.mark.parametrize(
    "parts", [[], [metadata("a")], [metadata("a"), raw(0x0B, b""), metadata("b", k="v")]]
)
def test_the_checksum_of_the_data_covers_all_before_its_end(tmp_path, parts):
    crc = zlib.crc32(MAGIC + b"".join(parts))
    file, starts = placed(tmp_path, *parts, record_bytes(DataEnd(crc)))
    assert [each[1] for each in found_in(file)] == starts[: len(parts)]
    bad, _ = placed(tmp_path, *parts, record_bytes(DataEnd(crc ^ 1)))
    with pytest.raises(LogError, match=f"before byte {starts[len(parts)]}: the checksum of the data section"):
        found_in(bad)
    assert len(found_in(bad, 0x03)) == len(parts), "where kinds are passed over it is not compared"
    none, _ = placed(tmp_path, *parts, record_bytes(DataEnd(0)))
    assert len(found_in(none)) == len(parts), "its writer may have made none"


def test_a_field_of_a_damaged_record_does_not_reach_past_its_end():
    assert Record(4, 77, channel(6, "/t")[9:], complete=True).parse().topic == "/t"
    assert Record(0x0D, 77, b"", complete=True).parse() is None
    with pytest.raises(LogError, match=r"^a field of 2 bytes reaches past the end"):
        Record(4, 77, b"1", complete=True).parse()


# -- sizes -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("opcode", "most"), [(0x06, 40 + 1024), (0x0C, 70), (0x01, 70)])
def test_a_record_may_be_as_large_as_its_kind_and_no_larger(tmp_path, monkeypatch, opcode, most):
    assert longest(Opcode.CHUNK) == 16 * MiB + 1024
    assert {longest(int(kind)) for kind in Opcode if kind != Opcode.CHUNK} == {64 * MiB}
    monkeypatch.setattr(mcap_read, "MAX_CHUNK", 40)
    monkeypatch.setattr(mcap_read, "MAX_RECORD", 70)
    file, starts = placed(tmp_path, metadata("a"), raw(opcode, bytes(most)), metadata("b"))
    assert [each[1] for each in found_in(file)] == starts
    file, starts = placed(tmp_path, metadata("a"), raw(opcode, bytes(most + 1)))
    with pytest.raises(LogError, match=f"damaged at byte {starts[1]}: .* {most + 1} bytes, allowed: {most}$"):
        found_in(file)
    assert found_in(file, opcode)[-1] == (NOTHING, starts[2], b"", False), "what is passed over is not read"
    file, starts = placed(tmp_path, struct.pack("<BQ", opcode, 1 << 40) + b"x" * (most + 1))
    assert found_in(file) == [(opcode, starts[0], b"x" * most, False)], "no more than allowed is read"


@pytest.mark.parametrize(("size", "unpacked", "messages"), [(0, 0, 0), (1000, 40_000, 125)])
def test_a_log_unpacks_to_so_much_more_for_each_byte_of_its_file(size, unpacked, messages):
    allowance = Allowance(size)
    allowance.spend(256 * MiB + unpacked)
    allowance.spend(messages=50_000 + messages)
    with pytest.raises(LogError, match=f"unpacks to more than {256 * MiB + unpacked},"):
        allowance.spend(1)
    with pytest.raises(LogError, match=f"more than {50_000 + messages} messages,"):
        allowance.spend(-1, messages=1)


# -- chunks ----------------------------------------------------------------------------------------------------

DATA = bytes(range(200)) + bytes(100)
PACK = {"zstd": zstandard.compress, "lz4": lz4.frame.compress, "": bytes}


def chunk(name, data, *, size=300, crc=0):
    return Chunk(
        message_start_time=0, message_end_time=1, uncompressed_size=size, uncompressed_crc=crc,
        compression=name, data=data,
    )  # fmt: skip


@pytest.mark.parametrize("name", PACK)
def test_a_chunk_is_unpacked_and_its_size_and_checksum_compared(name):
    packed = PACK[name](DATA)
    for crc in (0, zlib.crc32(DATA)):
        assert decompress(chunk(name, packed, crc=crc)) == DATA
    assert decompress(chunk(name, PACK[name](b""), size=0)) == b""
    wrong = [{"crc": zlib.crc32(DATA) ^ 1}, *({"size": size} for size in (0, len(DATA) - 1, len(DATA) + 1))]
    for changed in wrong:
        with pytest.raises(LogError, match="checksum differs"):
            decompress(chunk(name, packed, **changed))
    if name:
        with pytest.raises(LogError, match="cannot be decompressed"):
            decompress(chunk(name, DATA))


@pytest.mark.parametrize("name", ["zst", "ZSTD", "none", "\0"])
def test_a_chunk_of_an_unknown_compression_is_refused(name):
    for data in (DATA, zstandard.compress(DATA)):
        with pytest.raises(LogError, match="allowed are zstd, lz4 and none"):
            decompress(chunk(name, data))
        assert decompress_part(record_bytes(chunk(name, data))[9:]) == b""


@pytest.mark.parametrize("name", ["zstd", "lz4"])
def test_a_chunk_that_unpacks_to_too_much_is_refused_before(monkeypatch, name):
    bomb = PACK[name](bytes(50_000_000))
    with pytest.raises(LogError, match=f"at most {MAX_CHUNK}"):
        decompress(chunk(name, bomb, size=MAX_CHUNK + 1))
    tracemalloc.start()
    try:
        with pytest.raises(LogError, match="damaged"):
            decompress(chunk(name, bomb, size=1000))
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 1_000_000
    monkeypatch.setattr(mcap_read, "MAX_CHUNK", len(DATA))
    assert decompress(chunk("", DATA)) == DATA


@pytest.mark.parametrize("name", ["zstd", ""])
def test_the_beginning_of_a_chunk_gives_what_it_unpacks_to(name):
    large = np.random.default_rng(3).bytes(500) + bytes(18 * MiB)
    content = record_bytes(chunk(name, PACK[name](large)))[9:]
    assert decompress_part(content) == large[: 16 * MiB]
    for left_out in (1, 40):
        found = decompress_part(content[: len(content) - left_out])
        assert large.startswith(found)
        assert len(found) >= 500
    head = record_bytes(chunk(name, b""))[9:]
    assert {decompress_part(head[:size]) for size in range(len(head) + 1)} == {b""}
    assert decompress_part(record_bytes(chunk("zstd", DATA))[9:]) == b"", "damaged"


# -- messages --------------------------------------------------------------------------------------------------


def message(number, time, size):
    return raw(5, struct.pack("<HIQQ", number, 99, time, 88) + bytes(size))


def channel(number, topic):
    return record_bytes(Channel(id=number, topic=topic, message_encoding="", metadata={}, schema_id=0))


def test_each_message_has_its_channel_its_time_its_place_and_its_length():
    data = message(65535, 7, 0) + message(3, 2**63 - 1, 5) + message(258, 0, 1)
    table, others = split(data)
    assert all(column.dtype == np.int64 for column in table)
    expected = [[65535, 3, 258], [7, 2**63 - 1, 0], [0, 31, 67], [31, 36, 32]]
    assert [column.tolist() for column in table] == expected
    assert others == []
    assert [column.tolist() for column in table.before(np.array([0, 2]))] == [each[:2] for each in expected]
    assert table.before(np.zeros(0, int)).channel.tolist() == []
    assert [len(column) for column in split(b"")[0]] == [0] * 4


def test_a_message_has_22_bytes_at_least():
    for size in (0, 14, 21):
        short = raw(5, bytes(size))
        for data in (message(1, 5, 0) + short, short + message(1, 5, 0)):
            with pytest.raises(LogError, match=f"a message of {size} bytes, allowed: 22"):
                split(data)


@pytest.mark.parametrize("left", [1, 8, 9, 15, 30])
def test_a_buffer_ends_with_a_whole_record_unless_it_is_a_part(left):
    data = message(3, 9, 0) + message(3, 9, 0)[:left]
    with pytest.raises(LogError, match=f"{left} bytes of {31 + left} are no record"):
        split(data)
    table, others = split(data, part=True)
    assert (table.offset.tolist(), table.length.tolist(), others) == ([0], [31], [])


@pytest.mark.parametrize("place", [0, 1, 2])
@pytest.mark.parametrize("time", [2**63, 2**64 - 1])
def test_a_time_after_the_year_2262_is_refused(place, time):
    found = [message(1, 5, 0), message(1, 6, 0)]
    found.insert(place, message(1, time, 0))
    with pytest.raises(LogError, match="2262"):
        split(b"".join(found))


def test_1024_schemas_and_channels_may_stand_between_messages():
    schema, described, short = raw(3, b"schema" * 9), channel(6, "/t"), raw(4, b"")
    table, others = split(schema + message(1, 5, 2) + described + short)
    at = len(schema)
    assert table.offset.tolist() == [at]
    assert [(each.offset, each.whole, each.complete) for each in others] == [
        (0, schema, True), (at + 33, described, True), (at + 33 + len(described), short, True),
    ]  # fmt: skip
    most = raw(3, b"") * 1000 + raw(4, b"1") * 24
    assert len(split(most + message(1, 5, 0))[1]) == 1024
    for further in (3, 4):
        with pytest.raises(LogError, match=f"a record of kind {further} after 1024 others"):
            split(most + raw(further, b""))


@pytest.mark.parametrize("opcode", [0, 1, 2, 6, 7, 8, 0x0C, 0x0F, 0x80])
def test_a_record_of_another_kind_in_a_chunk_is_refused(opcode):
    for size in (0, 22, 50):
        with pytest.raises(LogError, match=f"a record of kind {opcode} after 1 others"):
            split(raw(4, b"") + raw(opcode, bytes(size)))


# -- the index at the end --------------------------------------------------------------------------------------

STATISTICS = record_bytes(
    Statistics(
        attachment_count=1, channel_count=2, channel_message_counts={7: 9, 300: 4}, chunk_count=3,
        message_count=13, message_end_time=6, message_start_time=5, metadata_count=7, schema_count=8,
    )
)  # fmt: skip
SCHEMA = record_bytes(Schema(id=9, name="s", encoding="e", data=b"123"))
PARTS = [SCHEMA, channel(7, "/a"), STATISTICS, channel(300, "/b")]


def ended(tmp_path, index, *, before=b"data", start=None, crc=None, opcode=Opcode.FOOTER, size=20):
    """A file with this index; the checksum over it is right unless it is given."""
    begin = len(MAGIC) + len(before) if start is None else start
    head = struct.pack("<BQQQ", opcode, size, begin, 11)
    crc = zlib.crc32(head, zlib.crc32(index)) if crc is None else crc
    path = tmp_path / "a.mcap"
    path.write_bytes(MAGIC + before + index + head + struct.pack("<I", crc) + MAGIC)
    return path


@pytest.mark.parametrize("before", [b"", b"\x01", b"\xff" * 5000])
@pytest.mark.parametrize("crc", [None, 0])
def test_counts_and_topics_are_found_wherever_the_index_begins(tmp_path, before, crc):
    figures, topics = read_summary(ended(tmp_path, b"".join(PARTS), before=before, crc=crc))
    assert record_bytes(figures) == STATISTICS
    assert topics == {7: "/a", 300: "/b"}
    for left in range(9):
        figures, topics = read_summary(ended(tmp_path, STATISTICS + bytes(left), before=before, crc=crc))
        assert (figures.message_count, topics) == (13, {}), "fewer bytes than a head has are passed over"


@pytest.mark.parametrize("place", ["first", "last", "start", "offsets", "crc"])
def test_a_flipped_bit_under_the_checksum_of_the_index_is_found(tmp_path, place):
    path = ended(tmp_path, b"".join(PARTS))
    data = bytearray(path.read_bytes())
    end, start = len(data) - len(MAGIC) - 29, len(MAGIC) + len(b"data")
    assert data[end] == Opcode.FOOTER
    at = {"first": start + 9, "last": end - 1, "start": end + 9, "offsets": end + 24, "crc": end + 28}[place]
    if place == "start":
        data[at] += len(SCHEMA)
        start += len(SCHEMA)
    else:
        data[at] ^= 0x40
    path.write_bytes(data)
    with pytest.raises(LogError, match=f"damaged between byte {start} and {end}: the checksum of the index"):
        read_summary(path)


SHORT, BEYOND = (
    struct.pack("<BQ", Opcode.CHANNEL, 1) + b"x",
    struct.pack("<BQ", Opcode.METADATA_INDEX, 5) + b"1234",
)
END = len(MAGIC) + 4


@pytest.mark.parametrize(
    ("index", "changed", "says"),
    [
        ([], {}, f"^damaged: the index at byte {END} has no statistics"),
        (PARTS[:2], {}, f"^damaged: the index at byte {END} has no statistics"),
        ([], {"start": END, "crc": 0}, f"^damaged: the index at byte {END} has no statistics"),
        *(
            ([], {"start": k}, f"^damaged at byte {END}: an index from byte {k} to")
            for k in (1, 7, END + 1, 1 << 40)
        ),
        ([STATISTICS], {"start": 0}, "no index at the end"),
        ([STATISTICS], {"opcode": 0x42}, "no footer"),
        ([STATISTICS], {"size": 21}, "no footer"),
        ([SHORT, STATISTICS], {}, f"^damaged at byte {END}: a field of 2 bytes"),
        (
            [STATISTICS, SCHEMA, SHORT],
            {},
            f"^damaged at byte {END + len(STATISTICS + SCHEMA)}: a field of 2 bytes",
        ),
        (
            [STATISTICS, BEYOND],
            {},
            f"^damaged at byte {END + len(STATISTICS)}: a record of the index reaches past",
        ),
        (
            [STATISTICS, BEYOND[:9]],
            {},
            f"^damaged at byte {END + len(STATISTICS)}: a record of the index reaches",
        ),
    ],
)
def test_a_damaged_index_is_refused_with_its_place(tmp_path, index, changed, says):
    with pytest.raises(LogError, match=says):
        read_summary(ended(tmp_path, b"".join(index), **changed))


@pytest.mark.parametrize("before", [0, 5000])
def test_an_index_of_more_than_the_largest_size_is_refused(tmp_path, monkeypatch, before):
    whole = ended(tmp_path, STATISTICS, before=bytes(before))
    monkeypatch.setattr(mcap_read, "MAX_SUMMARY", len(STATISTICS))
    assert read_summary(whole)[0].message_count == 13
    monkeypatch.setattr(mcap_read, "MAX_SUMMARY", len(STATISTICS) - 1)
    with pytest.raises(LogError, match="an index from byte"):
        read_summary(whole)
