"""Where the records of a damaged file begin and end, and which of them are whole."""

import struct
import zlib

import pytest
from mcap.opcode import Opcode
from mcap.records import Attachment, Chunk, DataEnd, Message, MessageIndex

from hil.record.mcap_file import MAGIC, record_bytes
from hil.record.mcap_read import HEAD, Record
from hil.record.salvage import Lost, surviving
from tests.hil.mcap_records import metadata, placed

A, B, C = metadata("a", a="1"), metadata("b", b="2"), metadata("c", c="3")
DATA_END = record_bytes(DataEnd(data_section_crc=0))


def message(data=b""):
    return record_bytes(Message(channel_id=99, log_time=1, data=data, publish_time=1, sequence=0))


@pytest.mark.parametrize("window", [1, 16, 64])
@pytest.mark.parametrize("last", ["metadata", "message index"])
def test_the_next_record_is_found_wherever_the_search_is_split(tmp_path, monkeypatch, window, last):
    """The file ends with the shortest record that there is behind a whole one, or with the whole one."""
    monkeypatch.setattr("hil.record.salvage._WINDOW", window)
    ends = {"metadata": [], "message index": [record_bytes(MessageIndex(channel_id=0, records=[]))]}
    for size in range(9, 75):
        file, starts = placed(tmp_path, metadata("a"), b"\xff" * size, metadata(""), *ends[last])
        first, lost, *whole = surviving(file)
        assert (first[1], lost) == (starts[0], Lost(starts[1], starts[2])), size
        assert [each[1] for each in whole] == starts[2:-1], size


@pytest.mark.parametrize(
    ("opcode", "length", "kept"), [(0x1C, 4, False), (0x0D, 4, True), (0x0F, 20, True), (0x02, 21, True)]
)
def test_a_record_of_unknown_kind_is_damage_and_an_odd_end_is_none(tmp_path, opcode, length, kept):
    odd = struct.pack("<BQ", opcode, length) + b"\xff" * length
    file, starts = placed(tmp_path, A, odd, B, C)
    found = [each[1] for each in surviving(file) if isinstance(each, Record)]
    assert found == [starts[k] for k in range(4) if kept or k != 1]


def test_a_record_as_long_as_a_footer_is_no_end(tmp_path):
    same = metadata("ab", a="1")
    assert len(same) == 9 + 20
    file, starts = placed(tmp_path, same, B)
    assert [each[1] for each in surviving(file)] == starts[:2]


@pytest.mark.parametrize("size", [1, 5, 8])
def test_bytes_at_the_end_that_are_too_few_for_a_record_are_lost(tmp_path, size):
    file, starts = placed(tmp_path, A, b"\x01" * size)
    assert list(surviving(file))[-1] == Lost(starts[1], starts[1] + size)


def test_a_message_without_a_byte_of_data_is_whole(tmp_path):
    file, starts = placed(tmp_path, A, b"\xff" * 9, message(), message(b"1"))
    *_, lost, first, second = surviving(file)
    assert lost == Lost(starts[1], starts[2])
    assert [each[1] for each in (first, second)] == starts[2:4]


# -- a damaged length ------------------------------------------------------------------------------------------


def damaged_first(tmp_path, length, last):
    """A file whose first record has this length; return it and where its records begin."""
    file, starts = placed(tmp_path, A, B, last)
    damaged = bytearray(A)
    damaged[1] = length(starts)
    file.write_bytes(MAGIC + damaged + file.read_bytes()[starts[1] :])
    return file, starts


TRAP = struct.pack("<BQ", 0x0C, 0x1313)
TRAPPED = metadata("c", c="3" + TRAP.decode() + "3")
BEYOND = {
    beyond: metadata("c", c=(struct.pack("<BQ", 0x0C, 60 + beyond) + b"3" * 60).decode())
    for beyond in (1, 9, 18, 40)
}


@pytest.mark.parametrize(
    ("length", "last"),
    [
        (lambda _: len(A) - 9 + 20, C),
        (lambda starts: starts[2] + TRAPPED.index(TRAP) - starts[0] - 9, TRAPPED),
        *(
            (lambda starts, last=last: starts[2] + len(last) - 69 - starts[0] - 9, last)
            for last in BEYOND.values()
        ),
    ],
    ids=["into the next", "to a trap", *(f"to {beyond} bytes beyond the file" for beyond in BEYOND)],
)
def test_a_damaged_length_costs_its_record_alone(tmp_path, length, last):
    """It ends within the next record, or at bytes that resemble one and would go on beyond the file."""
    file, starts = damaged_first(tmp_path, length, last)
    lost, *whole = surviving(file)
    assert lost == Lost(starts[0], starts[1])
    assert [each[1] for each in whole] == starts[1:3]


def test_the_last_byte_of_what_is_whole_is_not_the_first_of_a_record(tmp_path):
    """With the line feed at the end of the file's mark the damaged bytes behind it would be one."""
    assert MAGIC[-1] == 0x0A
    file, starts = placed(tmp_path, struct.pack("<Q", 40) + b"\xff" * 40, A, B)
    lost, *whole = surviving(file)
    assert lost == Lost(starts[0], starts[1])
    assert [each[1] for each in whole] == starts[1:3]


@pytest.mark.parametrize("longer", [0, 1])
def test_a_record_is_as_long_as_any_may_be_and_no_longer(tmp_path, monkeypatch, longer):
    whole = metadata("a", text="b" * 40)
    monkeypatch.setattr("hil.record.mcap_read.MAX_RECORD", len(whole) - HEAD.size - longer)
    file, starts = placed(tmp_path, whole, metadata("c"), metadata("d"))
    first, *others = surviving(file)
    assert first[:2] == ((starts[0], starts[1]) if longer else (Opcode.METADATA, starts[0]))
    assert [each[1] for each in others] == starts[1:3]


# -- records that hold records ---------------------------------------------------------------------------------

INNER = metadata("x", x="1") + metadata("y", y="2")
SUM = zlib.crc32(INNER)


def attachment(*, checked=True):
    """An attachment; its checksum, of all before it, is the last word, and may be left out as 0."""
    whole = record_bytes(Attachment(log_time=0, create_time=0, name="log", media_type="x", data=INNER))
    return whole if checked else whole[:-4] + bytes(4)


def unpacked(*, crc, spare=b"", compression=""):
    """A chunk in which the records can be read as they are, though it may have the form of a packed one."""
    stored = (
        b"\x28\xb5\x2f\xfd\x20" + bytes([len(INNER)]) + (len(INNER) << 3 | 1).to_bytes(3, "little") + INNER
    )
    content = record_bytes(
        Chunk(
            message_start_time=0, message_end_time=1, uncompressed_size=len(INNER), uncompressed_crc=crc,
            compression=compression, data=stored if compression else INNER,
        )
    )[9:]  # fmt: skip
    return struct.pack("<BQ", 6, len(content) + len(spare)) + content + spare


OUTER = {
    "attachment": (attachment(), True),
    "attachment, no sum": (attachment(checked=False), False),
    "attachment, wrong sum": (attachment()[:-1] + b"\0", False),
    "chunk": (unpacked(crc=SUM), True),
    "chunk of zstd": (unpacked(crc=SUM, compression="zstd"), True),
    "chunk, no sum": (unpacked(crc=0), False),
    "chunk, wrong sum": (unpacked(crc=SUM ^ 1), False),
    "chunk, spare byte": (unpacked(crc=SUM, spare=b"\0"), False),
    "chunk of zstd, spare bytes": (unpacked(crc=SUM, spare=b"\0" * 8, compression="zstd"), False),
    "metadata": (metadata("b", b=INNER.decode("latin-1")), False),
}


@pytest.mark.parametrize(("outer", "whole"), OUTER.values(), ids=OUTER)
def test_before_damage_a_record_counts_where_its_own_checksum_holds(tmp_path, outer, whole):
    path, starts = placed(tmp_path, A, outer, b"\xff" * 50, C, metadata("d", d="4"))
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


@pytest.mark.parametrize("end", [[], [DATA_END]], ids=["file", "data"])
def test_the_last_record_is_whole_whatever_records_its_text_resembles(tmp_path, end):
    inner = (metadata("x" * 40) + metadata("y" * 40)).decode("latin-1")
    file, starts = placed(tmp_path, A, metadata("b", b=inner), *end)
    found = list(surviving(file))
    assert [each[1] for each in found] == starts[:2]
    assert all(isinstance(each, Record) and each.complete for each in found)
