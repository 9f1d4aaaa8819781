"""The index at the end of a log as it is read for the figures: its borders, its checksum, what it has to hold."""

import struct
import zlib
from io import BytesIO
from pathlib import Path

import pytest
from mcap.opcode import Opcode
from mcap.records import Channel, Schema, Statistics

from drivers.errors import LogError
from hil.record import mcap_read
from hil.record.mcap_file import MAGIC, record_bytes
from hil.record.mcap_read import read_summary


def statistics(messages):
    return record_bytes(
        Statistics(
            attachment_count=1, channel_count=2, channel_message_counts={7: messages, 300: 4}, chunk_count=3,
            message_count=messages + 4, message_end_time=6, message_start_time=5, metadata_count=7,
            schema_count=8,
        )
    )  # fmt: skip


def channel(number, topic):
    return record_bytes(
        Channel(id=number, topic=topic, message_encoding="raw", metadata={"k": "v"}, schema_id=9)
    )


SCHEMA = record_bytes(Schema(id=9, name="s", encoding="e", data=b"123"))
PARTS = [SCHEMA, channel(7, "/a"), statistics(9), channel(300, "/b")]


def ended(tmp_path, index, *, before=b"data", start=None, crc=None, offsets=11):
    """A file with this index; the checksum over it is right unless it is given."""
    begin = len(MAGIC) + len(before)
    head = struct.pack("<BQQQ", Opcode.FOOTER, 20, begin if start is None else start, offsets)
    crc = zlib.crc32(head, zlib.crc32(index)) if crc is None else crc
    path = tmp_path / "a.mcap"
    path.write_bytes(MAGIC + before + index + head + struct.pack("<I", crc) + MAGIC)
    return path


@pytest.mark.parametrize("before", [b"", b"\x01", b"\xff" * 5000])
@pytest.mark.parametrize("crc", [None, 0])
def test_the_figures_and_the_topics_of_all_channels_are_found_wherever_the_index_begins(
    tmp_path, before, crc
):
    figures, topics = read_summary(ended(tmp_path, b"".join(PARTS), before=before, crc=crc))
    assert record_bytes(figures) == statistics(9)
    assert topics == {7: "/a", 300: "/b"}


def test_an_index_may_begin_with_its_figures_or_end_with_them(tmp_path):
    for parts in ([PARTS[2], *PARTS[:2]], [*PARTS[:2], PARTS[2]], [PARTS[2]]):
        figures, topics = read_summary(ended(tmp_path, b"".join(parts)))
        assert (figures.message_count, topics) == (13, {7: "/a"} if len(parts) > 1 else {})


@pytest.mark.parametrize("place", ["first", "last", "start", "offsets", "crc"])
def test_a_bit_that_has_turned_over_anywhere_under_the_checksum_of_the_index_is_found(tmp_path, place):
    path = ended(tmp_path, b"".join(PARTS))
    data = bytearray(path.read_bytes())
    end = len(data) - len(MAGIC) - 29
    start = len(MAGIC) + len(b"data")
    assert data[end] == Opcode.FOOTER
    at = {"first": start + 9, "last": end - 1, "start": end + 9, "offsets": end + 24, "crc": end + 28}[place]
    if place == "start":
        data[at] += 9 + len(SCHEMA[9:])
        start += len(SCHEMA)
    else:
        data[at] ^= 0x40
    path.write_bytes(data)
    with pytest.raises(
        LogError, match=f"damaged between byte {start} and {end}: the checksum of the index differs"
    ):
        read_summary(path)


@pytest.mark.parametrize("left", range(9))
def test_behind_the_last_record_of_the_index_fewer_bytes_than_a_head_has_are_passed_over(tmp_path, left):
    figures, _ = read_summary(ended(tmp_path, PARTS[2] + bytes(left)))
    assert figures.message_count == 13


def test_an_index_without_figures_is_damaged(tmp_path):
    for parts, before in (([], b""), (PARTS[:2], b"1234"), ([], b"12")):
        start = len(MAGIC) + len(before)
        with pytest.raises(LogError, match=f"^damaged: the index at byte {start} has no statistics$"):
            read_summary(ended(tmp_path, b"".join(parts), before=before))


@pytest.mark.parametrize("start", [1, 7, 18, 1 << 40])
def test_an_index_begins_behind_the_head_of_the_file_and_before_the_footer(tmp_path, start):
    """Up to byte 17 it would be an index, of nothing."""
    path = ended(tmp_path, b"", before=b"\x42" + bytes(8), start=start)
    size = path.stat().st_size
    with pytest.raises(LogError, match=f"^damaged at byte 17: an index from byte {start} to 17 of {size}$"):
        read_summary(path)
    for inside in (8, 17):
        path = ended(tmp_path, b"", before=b"\x42" + bytes(8), start=inside, crc=0)
        with pytest.raises(LogError, match=f"^damaged: the index at byte {inside} has no statistics$"):
            read_summary(path)


class AskedError(Exception):
    """So many bytes were asked for."""


class EndOnly(BytesIO):
    """A file of zeros but for its end, which alone may be read."""

    def __init__(self, size, end):
        super().__init__(end)
        self.before = size - len(end)

    def seek(self, place, whence=0):
        if whence:
            return self.before + super().seek(place, whence)
        return self.before + super().seek(max(0, place - self.before))

    def read(self, count=-1):
        if count > 37:
            raise AskedError(count)
        return super().read(count)


def test_an_index_has_256_MiB_at_most_and_a_larger_one_is_refused_before_it_is_read(monkeypatch):
    most, start = 256 * 1024 * 1024, 8
    end = struct.pack("<BQQQI", Opcode.FOOTER, 20, start, 0, 0) + MAGIC
    given = iter([EndOnly(start + most + more + 37, end) for more in (0, 1)])
    monkeypatch.setattr(mcap_read, "open_regular", lambda _: next(given))
    with pytest.raises(AskedError, match=f"^{most}$"):
        read_summary(Path("large"))
    with pytest.raises(LogError, match=f"an index from byte 8 to {8 + most + 1} of {8 + most + 38}$"):
        read_summary(Path("larger"))


def test_a_record_of_the_index_that_is_damaged_is_named_with_its_place_in_the_file(tmp_path):
    short = struct.pack("<BQ", Opcode.CHANNEL, 1) + b"x"
    for parts in ([short, PARTS[2]], [PARTS[2], SCHEMA, short]):
        index = b"".join(parts)
        place = len(MAGIC) + 4 + index.index(short)
        with pytest.raises(
            LogError, match=f"^damaged at byte {place}: a field of 2 bytes reaches past the end"
        ):
            read_summary(ended(tmp_path, index))
    path = ended(tmp_path, PARTS[2] + struct.pack("<BQ", Opcode.CHANNEL, 5) + b"1234")
    place = len(MAGIC) + 4 + len(PARTS[2])
    with pytest.raises(
        LogError, match=f"^damaged at byte {place}: a record of the index reaches past its end$"
    ):
        read_summary(path)
