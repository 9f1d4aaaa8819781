"""The container of a log: what its end says of it, what is passed over in it, and what is refused in it."""

import dataclasses
import shutil
import struct
from pathlib import Path

import numpy as np
import pytest
import zstandard
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    Channel,
    Chunk,
    ChunkIndex,
    Metadata,
    Statistics,
    SummaryOffset,
)
from mcap.records import Schema as SchemaRecord
from mcap.stream_reader import StreamReader

from drivers.errors import LogError
from hil.record import mcap_read as index_of
from hil.record.log import Log, Tick
from hil.record.mcap_file import MAGIC, record_bytes
from hil.record.mcap_read import NOTHING, Record, read_summary, records, split
from hil.record.salvage import salvage
from tests.hil.rewrite import mcap_summary
from tests.hil.samples import assert_same, log_of, random_rows, random_ticks
from tools.fuzz import container

TICKS = random_ticks(300, seed=14)
OLD = Path(__file__).parents[1] / "data" / "log_0.1.0.mcap"


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return log_of(TICKS, tmp_path_factory)


@pytest.fixture
def made(tmp_path):
    """Write a file of records, its checksums made anew; return its path."""

    def write(records):
        (tmp_path / "made.mcap").write_bytes(container.whole(records))
        return tmp_path / "made.mcap"

    return write


# -- the index -----------------------------------------------------------------------------------------------


def test_the_offsets_at_the_end_say_where_the_records_of_each_kind_of_the_index_lie(path):
    """A reader that looks for one kind goes by them."""
    data = path.read_bytes()
    with path.open("rb") as file:
        found = [r for r in StreamReader(file).records if isinstance(r, SummaryOffset)]
    start, offsets, _ = struct.unpack_from("<QQI", data, len(data) - len(MAGIC) - 20)
    at = start
    for group in found:
        assert group.group_start == at
        inside = container.split(data[at : at + group.group_length])
        assert {opcode for opcode, _ in inside} == {group.group_opcode}
        assert len(container.joined(inside)) == group.group_length
        at += group.group_length
    assert at == offsets
    assert len(found) == len({group.group_opcode for group in found}) == 6


STATISTICS = record_bytes(
    Statistics(
        attachment_count=0, channel_count=0, channel_message_counts={1: 7}, chunk_count=0, message_count=7,
        message_end_time=0, message_start_time=0, metadata_count=0, schema_count=0,
    )
)  # fmt: skip


def ended(tmp_path, index, *, opcode=int(Opcode.FOOTER), before=b""):
    """A file with this index and no checksum over it."""
    start = len(MAGIC) + len(before)
    footer = struct.pack("<BQQQI", opcode, 20, start, 0, 0)
    (tmp_path / "a.mcap").write_bytes(MAGIC + before + index + footer + MAGIC)
    return tmp_path / "a.mcap"


@pytest.mark.parametrize("there", [0, 1, 4])
def test_a_last_record_of_the_index_that_reaches_past_its_end_is_named(tmp_path, there):
    bad = ended(tmp_path, STATISTICS + struct.pack("<BQ", 0x0B, 5) + bytes(there))
    place = len(MAGIC) + len(STATISTICS)
    with pytest.raises(
        LogError, match=f"damaged at byte {place}: a record of the index reaches past its end"
    ):
        read_summary(bad)


def test_a_last_record_of_the_index_without_a_byte_in_it_is_one(tmp_path):
    statistics, topics = read_summary(ended(tmp_path, STATISTICS + struct.pack("<BQ", 0x08, 0)))
    assert (statistics.channel_message_counts, topics) == ({1: 7}, {})


def test_what_stands_in_the_place_of_the_footer_is_none_by_its_kind_or_its_length(tmp_path):
    with pytest.raises(LogError, match="no footer"):
        read_summary(ended(tmp_path, STATISTICS, opcode=0x42))
    data = bytearray(ended(tmp_path, STATISTICS).read_bytes())
    data[-len(MAGIC) - 28] = 21
    (tmp_path / "a.mcap").write_bytes(data)
    with pytest.raises(LogError, match="no footer"):
        read_summary(tmp_path / "a.mcap")
    for size in (0, len(MAGIC), 36):
        (tmp_path / "a.mcap").write_bytes(bytes(data[-size:] if size else b""))
        with pytest.raises(LogError, match="damaged at byte 0: no footer"):
            read_summary(tmp_path / "a.mcap")


@pytest.mark.parametrize("before", [0, 5000])
def test_the_index_may_be_so_large_wherever_in_the_file_it_begins_and_no_larger(
    tmp_path, monkeypatch, before
):
    whole = ended(tmp_path, STATISTICS, before=bytes(before))
    monkeypatch.setattr(index_of, "MAX_SUMMARY", len(STATISTICS))
    assert read_summary(whole)[0].message_count == 7
    monkeypatch.setattr(index_of, "MAX_SUMMARY", len(STATISTICS) - 1)
    with pytest.raises(LogError, match="an index from byte"):
        read_summary(whole)


def test_times_in_the_index_are_those_of_the_first_and_the_last_message_of_a_chunk(path):
    with path.open("rb") as file:
        chunks = [r for r in StreamReader(file).records if isinstance(r, ChunkIndex)]
    statistics = mcap_summary(path).statistics
    assert len(chunks) > 1
    assert min(c.message_start_time for c in chunks) == statistics.message_start_time
    assert max(c.message_end_time for c in chunks) == statistics.message_end_time
    times = [t_ns for tick in TICKS for t_ns, _ in tick.received] + [int(t.row["t_ns"]) for t in TICKS]
    epoch = Log(path).epoch_ns
    assert statistics.message_start_time == epoch + min(times)
    assert statistics.message_end_time == epoch + max(times)


# -- what is passed over, and what is missing ----------------------------------------------------------------


def test_the_figures_of_a_log_are_those_of_its_index_and_of_its_end(path):
    times = [t_ns for tick in TICKS for t_ns, _ in tick.received] + [int(t.row["t_ns"]) for t in TICKS]
    found = Log(path).summary
    assert found.duration_s == pytest.approx(1e-9 * (max(times) - min(times)), rel=1e-9)
    assert (found.ticks, found.dropped, found.closed) == (len(TICKS), 0, "clean")


@pytest.mark.parametrize(
    ("said", "dropped"),
    [("44", 44), ("0", 0), ("9" * 18, 10**18 - 1), ("9" * 19, 0), ("x", 0), ("-1", 0), ("", 0)],
)
def test_as_many_ticks_were_dropped_as_the_end_of_the_log_says_in_plain_digits(path, made, said, dropped):
    end = Metadata(name="summary", metadata={"closed": "clean", "dropped": said})
    parts = container.split(path.read_bytes())
    last = max(k for k, (kind, _) in enumerate(parts) if kind == container.METADATA)
    parts[last] = (container.METADATA, record_bytes(end)[9:])
    found = Log(made(parts)).summary
    assert (found.dropped, found.closed, found.ticks) == (dropped, "clean", len(TICKS))


def test_an_index_that_is_not_there_is_said_so(tmp_path):
    data = bytearray(ended(tmp_path, STATISTICS).read_bytes())
    struct.pack_into("<Q", data, len(data) - len(MAGIC) - 20, 0)
    (tmp_path / "a.mcap").write_bytes(data)
    with pytest.raises(LogError, match="no index at the end"):
        read_summary(tmp_path / "a.mcap")


def test_a_log_that_goes_while_it_is_open_is_said_to_be_unreadable(path, tmp_path):
    shutil.copy(path, tmp_path / "a.mcap")
    log = Log(tmp_path / "a.mcap")
    (tmp_path / "a.mcap").unlink()
    reads = (lambda: log.summary, log.rows, log.events, lambda: list(log.ticks()), log.verify)
    for read in reads:
        with pytest.raises(LogError, match=r"a\.mcap: cannot be read: No such file"):
            read()


def test_records_of_the_kinds_that_are_not_wanted_are_passed_over(path):
    every = [(r.opcode, r.offset) for r in records(path)]
    kinds = {opcode for opcode, _ in every}
    assert {Opcode.CHUNK, Opcode.MESSAGE_INDEX, Opcode.METADATA, Opcode.ATTACHMENT} <= kinds
    for skip in ({Opcode.CHUNK}, {Opcode.CHUNK, Opcode.MESSAGE_INDEX}, {Opcode.METADATA}):
        found = list(records(path, frozenset(map(int, skip))))
        assert [(r.opcode, r.offset) for r in found] == [each for each in every if each[0] not in skip]
        assert all(r.complete and r.opcode != NOTHING for r in found)


def test_a_log_without_its_configuration_says_so_when_it_is_asked_for_it(path, made):
    parts = container.split(path.read_bytes())
    log = Log(made([part for part in parts if part[0] != container.ATTACHMENT]))
    assert len(log.rows("tick")) == len(TICKS)
    with pytest.raises(LogError, match=r"no attachment config\.yaml: the configuration of the run is not"):
        _ = log.configuration


def test_a_configuration_that_is_no_text_is_named(path, made):
    other = record_bytes(
        Attachment(log_time=0, create_time=0, name="config.yaml", media_type="", data=b"a: \xff")
    )
    parts = [
        (kind, other[9:] if kind == container.ATTACHMENT else content)
        for kind, content in container.split(path.read_bytes())
    ]
    with pytest.raises(LogError, match=r"attachment config\.yaml is no text"):
        _ = Log(made(parts)).configuration


@pytest.mark.parametrize("there", [0, 5, 9, 10, 12, 13, 14])
def test_a_log_that_is_cut_within_the_record_that_ends_its_data_gives_all_its_ticks(path, tmp_path, there):
    data = path.read_bytes()
    end = data.rindex(struct.pack("<BQ", container.DATA_END, 4))
    (tmp_path / "cut.mcap").write_bytes(data[: end + there])
    log = Log(tmp_path / "cut.mcap")
    assert log.cut
    assert_same(log.ticks(), TICKS)
    report = salvage(tmp_path / "cut.mcap", tmp_path / "out.mcap")
    assert report.ticks == len(TICKS)
    assert report.complete or 0 < there < 9, "of less than a head nobody knows what it was"


@pytest.mark.parametrize("length", [0, 3, 5])
def test_an_end_of_the_data_of_another_length_is_damaged(path, tmp_path, length):
    data = bytearray(path.read_bytes())
    end = data.rindex(struct.pack("<BQ", container.DATA_END, 4))
    data[end + 1] = length
    (tmp_path / "bad.mcap").write_bytes(data)
    with pytest.raises(LogError, match=f"damaged at byte {end}: the end of the data has {length} bytes"):
        Log(tmp_path / "bad.mcap").rows()


# -- messages ------------------------------------------------------------------------------------------------


def message(size):
    """A record of a message with so many bytes behind opcode and length."""
    return struct.pack("<BQ", 5, size) + struct.pack("<HIQQ", 3, 0, 9, 9)[:size].ljust(size, b"\0")


def test_the_shortest_message_has_22_bytes(tmp_path):
    table, others = split(message(22) + message(30) + message(22))
    assert (table.channel.tolist(), table.log_time.tolist()) == ([3, 3, 3], [9, 9, 9])
    assert (table.offset.tolist(), table.length.tolist()) == ([0, 31, 70], [31, 39, 31])
    assert others == []
    for size in (0, 14, 21):
        with pytest.raises(LogError, match=f"a message of {size} bytes, allowed: 22 and more"):
            split(message(22) + message(size))
        with pytest.raises(LogError, match=f"a message of {size} bytes, allowed: 22 and more"):
            split(message(size) + message(22))


@pytest.mark.parametrize("left", [1, 8, 9, 15, 30])
def test_a_buffer_ends_with_a_whole_record_unless_it_is_a_part(left):
    data = message(22) + message(22)[:left]
    with pytest.raises(LogError, match=f"{left} bytes of {31 + left} are no record"):
        split(data)
    table, others = split(data, part=True)
    assert (table.offset.tolist(), table.length.tolist(), others) == ([0], [31], [])


@pytest.mark.parametrize(
    "record",
    [
        Attachment(create_time=3, log_time=4, name="a", media_type="text/x", data=b"56"),
        Channel(id=3, topic="/t", message_encoding="e", metadata={"k": "v", "l": "w"}, schema_id=4),
        Chunk(
            compression="zs", data=b"34", message_start_time=5, message_end_time=6, uncompressed_crc=7,
            uncompressed_size=8,
        ),
        Metadata(name="n", metadata={"k": "v", "l": ""}),
        SchemaRecord(id=3, name="n", encoding="e", data=b"45"),
        Statistics(
            attachment_count=3, channel_count=4, channel_message_counts={5: 6, 7: 8}, chunk_count=9,
            message_count=10, message_end_time=11, message_start_time=12, metadata_count=13, schema_count=14,
        ),
    ],
    ids=lambda record: type(record).__name__,
)  # fmt: skip
def test_a_record_is_read_as_it_was_given_to_the_library_that_writes_it(record):
    whole = record_bytes(record)
    found = Record(whole[0], 0, whole[9:], complete=True).parse()
    assert dataclasses.asdict(found) == dataclasses.asdict(record)


def test_a_file_that_ends_within_a_record_ends_with_what_there_is_of_it(path, tmp_path):
    data = path.read_bytes()
    second = [r for r in records(path) if r.opcode == Opcode.METADATA][1]
    for there in range(32):
        (tmp_path / "cut.mcap").write_bytes(data[: second.offset + there])
        *_, last = records(tmp_path / "cut.mcap")
        assert (last.offset, last.complete) == (second.offset, False)
        assert last.opcode == (Opcode.METADATA if there >= 9 else NOTHING)
        assert last.content == second.content[: max(0, there - 9)]


def test_a_buffer_without_a_message_is_an_empty_table():
    table, others = split(b"")
    assert [len(column) for column in table] == [0, 0, 0, 0]
    assert all(column.dtype == np.int64 for column in table)
    assert others == []


@pytest.mark.parametrize("whole", [0, 1, 3])
def test_frames_of_a_cut_chunk_in_which_no_tick_has_begun_are_left_out(path, tmp_path, whole):
    """Another program may part chunks within a tick."""
    parts = container.split(path.read_bytes())
    at = [k for k, (kind, _) in enumerate(parts) if kind == container.CHUNK][1]
    inner = container.split(container.unpacked(parts[at][1]))
    frames = [each for each in inner[1:20] if each[0] == container.MESSAGE and len(each[1]) < 200]
    assert len(frames) > 3
    records = container.joined(frames[: whole + 1])[:-1]
    chunk = struct.pack("<QQQII", 0, 1, 5000, 0, 4) + b"zstd" + struct.pack("<Q", 5000)
    chunk += zstandard.compress(records)
    before = MAGIC + container.joined(parts[:at])
    (tmp_path / "cut.mcap").write_bytes(before)
    expected = list(Log(tmp_path / "cut.mcap").ticks())
    frames_before = len(list(Log(tmp_path / "cut.mcap").can_frames()))
    (tmp_path / "cut.mcap").write_bytes(before + struct.pack("<BQ", container.CHUNK, 9000) + chunk)
    log = Log(tmp_path / "cut.mcap")
    assert_same(log.ticks(), expected)
    assert len(list(log.can_frames())) == frames_before > 0
    report = salvage(tmp_path / "cut.mcap", tmp_path / "out.mcap")
    assert (report.ticks, report.partial_messages) == (len(expected), 0)
    assert len(list(Log(tmp_path / "out.mcap").can_frames())) == frames_before


def log_with(order, folder):
    """A log whose rows stand in another order."""
    rows = random_rows(len(order))
    return Log(log_of([Tick(rows[k], (), (), (), (), ()) for k in order], folder))


def test_a_row_that_was_moved_far_from_its_place_is_refused_where_ticks_are_read_as_they_come(
    tmp_path_factory,
):
    order = list(range(600))
    order.insert(400, order.pop(100))
    log = log_with(order, tmp_path_factory)
    for read in (log.ticks, log.blocks):
        with pytest.raises(LogError, match="messages stand more than 64 ticks out of order"):
            list(read())
    assert log.rows("tick")["tick"].tolist() == list(range(600))


def test_rows_that_were_moved_a_little_come_in_their_order(tmp_path_factory):
    order = list(range(600))
    for moved, by in ((500, 60), (300, 1), (100, 60)):
        order.insert(moved + by, order.pop(moved))
    log = log_with(order, tmp_path_factory)
    assert [int(tick.row["tick"]) for tick in log.ticks()] == list(range(600))
    assert np.concatenate(list(log.blocks("tick")))["tick"].tolist() == list(range(600))
