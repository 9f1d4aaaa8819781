"""Where the records of a damaged file begin and end: borders of the file, of the pieces read, of its data."""

import struct

import pytest
from mcap.opcode import Opcode
from mcap.records import DataEnd, MessageIndex

from hil.record.mcap_file import MAGIC, record_bytes
from hil.record.mcap_read import HEAD, Record
from hil.record.salvage import Lost, surviving
from tests.hil.mcap_records import metadata, placed

DATA_END = record_bytes(DataEnd(data_section_crc=0))


@pytest.mark.parametrize("window", [1, 16, 64])
@pytest.mark.parametrize("last", ["metadata", "message index"])
def test_the_next_record_is_found_wherever_a_piece_of_the_file_ends_that_is_looked_through(
    tmp_path, monkeypatch, window, last
):
    """The file ends with the shortest record that there is behind a whole one, or with the whole one."""
    monkeypatch.setattr("hil.record.salvage._WINDOW", window)
    ends = {"metadata": [], "message index": [record_bytes(MessageIndex(channel_id=0, records=[]))]}
    for size in range(9, 75):
        file, starts = placed(tmp_path, metadata("a"), b"\xff" * size, metadata(""), *ends[last])
        first, lost, *whole = surviving(file)
        assert (first[1], lost) == (starts[0], Lost(starts[1], starts[2])), size
        assert [each[1] for each in whole] == starts[2:-1], size


@pytest.mark.parametrize(
    ("opcode", "length", "is_one"),
    [
        (0x1C, 4, False),
        (0x0D, 4, True),
        (0x0F, 20, True),
        (0x02, 21, True),
    ],
)
def test_only_a_footer_of_20_bytes_is_the_end(tmp_path, opcode, length, is_one):
    """Longer ones are records of some kind, shorter ones damage."""
    odd = struct.pack("<BQ", opcode, length) + b"\xff" * length
    file, starts = placed(tmp_path, metadata("a", a="1"), odd, metadata("b", b="2"), metadata("c", c="3"))
    found = [each[1] for each in surviving(file) if isinstance(each, Record)]
    assert found == [starts[k] for k in range(4) if is_one or k != 1]


@pytest.mark.parametrize("beyond", [1, 9, 18, 40])
def test_a_record_that_would_end_a_little_beyond_the_file_is_none(tmp_path, beyond):
    """A damaged length ends at what looks like one."""
    damaged, rest = bytearray(metadata("a", a="1")), b"3" * 60
    length = len(rest) + beyond
    last = metadata("c", c=(struct.pack("<BQ", 0x0C, length) + rest).decode())
    file, starts = placed(tmp_path, bytes(damaged), metadata("b", b="2"), last)
    damaged[1] = file.stat().st_size - len(rest) - 9 - starts[0] - 9
    file.write_bytes(MAGIC + damaged + file.read_bytes()[starts[1] :])
    lost, *whole = surviving(file)
    assert lost == Lost(starts[0], starts[1])
    assert [each[1] for each in whole] == starts[1:3]


def test_the_last_byte_of_what_is_whole_is_not_taken_for_the_first_of_a_record(tmp_path):
    """With the line feed at the end of the file's mark the damaged bytes behind it would be one."""
    assert MAGIC[-1] == 0x0A
    damaged = struct.pack("<Q", 40) + b"\xff" * 40
    file, starts = placed(tmp_path, damaged, metadata("a", a="1"), metadata("b", b="2"))
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
