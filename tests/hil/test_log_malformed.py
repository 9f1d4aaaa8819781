"""Logs of strangers: every damage is a LogError with its place, and salvage goes on behind it."""

import json
import os
import struct
import tracemalloc

import pytest
from mcap.reader import make_reader
from mcap.records import Metadata
from mcap_protobuf.decoder import DecoderFactory

from drivers.errors import LogError
from hil.record.log import Log
from hil.record.mcap_file import MAGIC, record_bytes
from hil.record.mcap_read import FREE_BYTES, MAX_RATIO, NOTHING, records
from hil.record.salvage import salvage
from hil.record.schema import FRAME, IDENTITY
from tests.hil.rewrite import mcap_summary, rewrite_log
from tests.hil.samples import assert_same, log_of, random_ticks
from tools.fuzz import container

COUNT = 700
TICKS = random_ticks(COUNT, seed=11)


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return log_of(TICKS, tmp_path_factory, configuration="wn_rad_s: 20\n")


@pytest.fixture(scope="module")
def chunks(path):
    return mcap_summary(path).chunk_indexes


@pytest.fixture
def damaged(path, tmp_path):
    """Write the log with some bytes replaced, checksums left as they are; return its path."""

    def write(at, data):
        content = bytearray(path.read_bytes())
        content[at : at + len(data)] = data
        (tmp_path / "bad.mcap").write_bytes(content)
        return tmp_path / "bad.mcap"

    return write


@pytest.fixture
def remade(path, tmp_path):
    """Write the log with other records, the checksums of data section and index made anew; return its path."""

    def write(change):
        records = change(container.split(path.read_bytes()))
        (tmp_path / "remade.mcap").write_bytes(container.whole(records))
        return tmp_path / "remade.mcap"

    return write


def replaced(records, opcode, content):
    """Return records with the first one of a kind changed."""
    k = next(k for k, (kind, _) in enumerate(records) if kind == opcode)
    return [*records[:k], (opcode, content(records[k][1])), *records[k + 1 :]]


# -- checksums -----------------------------------------------------------------------------------------------


def test_a_changed_figure_in_the_attached_configuration_is_found(path, damaged):
    at = path.read_bytes().index(b"wn_rad_s: 20") + 10
    with pytest.raises(LogError, match=r"damaged at byte \d+: attachment 'config.yaml' .* --salvage"):
        Log(damaged(at, b"30"))


def test_changed_metadata_are_found_by_the_checksum_of_the_data_section(path, damaged):
    bad = damaged(path.read_bytes().index(b"can0") + 3, b"1")
    assert Log(bad).can_channel == "can1"
    with pytest.raises(LogError, match="checksum of the data section differs"):
        Log.open(bad)
    with pytest.raises(LogError, match="checksum of the data section differs"):
        Log(bad).rows()


def test_an_attachment_that_says_that_it_has_no_checksum_is_taken(remade):
    assert Log.open(remade(lambda r: replaced(r, 9, lambda c: c[:-4] + bytes(4)))).configuration


# -- sizes ---------------------------------------------------------------------------------------------------


def test_a_small_file_that_unpacks_without_end_is_refused_in_little_memory(remade):
    def bomb(records):
        chunk = next(content for kind, content in records if kind == 6)
        row = next(c for kind, c in container.split(container.unpacked(chunk)) if kind == 5)
        large = container.joined([(5, row[:22] + bytes(1 << 23))])
        return [*records[:-1], *[(6, container.packed(chunk, large))] * 60, records[-1]]

    def placed(records):
        end = next(k for k, (kind, _) in enumerate(records) if kind == 15)
        return [*bomb(records[: end + 1]), *records[end + 1 :]]

    bad = remade(placed)
    assert bad.stat().st_size * MAX_RATIO + FREE_BYTES < 60 << 23
    tracemalloc.start()
    try:
        with pytest.raises(LogError, match="unpacks to more than"):
            for _ in Log(bad).can_frames():
                pass
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 100e6


def test_a_file_that_holds_more_messages_than_a_log_of_its_size_is_refused_by_every_reader(path, monkeypatch):
    monkeypatch.setattr("hil.record.mcap_read.FREE_MESSAGES", 100)
    monkeypatch.setattr("hil.record.mcap_read.LEAST_BYTES", 1 << 40)
    log = Log(path)
    for read in (log.rows, lambda: list(log.blocks("q")), lambda: list(log.ticks()), log.events):
        with pytest.raises(LogError, match=r"more than 100 messages, which no log of a run has"):
            read()


@pytest.mark.parametrize(
    ("limit", "says"),
    [
        ({"FREE_BYTES": 1000, "MAX_RATIO": 0}, "unpacks to more than 1000"),
        ({"FREE_MESSAGES": 100, "LEAST_BYTES": 1 << 40}, "more than 100 messages"),
    ],
)
def test_salvage_unpacks_no_more_of_a_file_than_reading_does(path, tmp_path, monkeypatch, limit, says):
    for name, value in limit.items():
        monkeypatch.setattr(f"hil.record.mcap_read.{name}", value)
    report = salvage(path, tmp_path / "out.mcap")
    assert (report.chunks, report.ticks) == (0, 0)
    assert any(says in remark for remark in report.remarks)


def test_messages_too_short_for_their_rows_are_refused(remade):
    def short(records):
        def many(content):
            inner = container.split(container.unpacked(content))
            row = next(c for kind, c in inner if kind == 5 and len(c) > 1000)
            return container.packed(content, container.joined([(5, row[:22])] * 20_000))

        return replaced(records, 6, many)

    with pytest.raises(LogError, match="a message of /tick is damaged"):
        Log(remade(short)).rows()


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (b'"shape": [3, 3]', b'"shape": [9, 9]'),
        (b'"shape": [3, 3]', b'"shape":[3,9e9]'),
        (b'"unit"', b'"un\x1bt"'),
    ],
)
def test_a_table_of_columns_that_asks_for_too_much_is_refused(remade, old, new):
    with pytest.raises(LogError, match="metadata record 'hil' cannot be read"):
        Log(remade(lambda r: replaced(r, 12, lambda c: c.replace(old, new))))


@pytest.mark.parametrize(
    ("names", "says"),
    [
        (["can0"] * 20, "20 names of buses"),
        (["can0", "x" * 5000], "2 names .* of 4096 signs"),
        (["\x07"], r"\\x07"),
    ],
)
def test_names_of_more_buses_than_a_robot_has_are_refused_before_frames_are_laid_out(
    path, remade, names, says
):
    identity = Log(path).metadata[IDENTITY]

    def named(channels):
        changed = Metadata(name=IDENTITY, metadata=identity | {"can_channels": json.dumps(channels)})
        return remade(lambda r: replaced(r, 12, lambda _: record_bytes(changed)[9:]))

    with pytest.raises(LogError, match=f"metadata record 'hil' cannot be read.*{says}") as refused:
        Log(named(names))
    assert len(str(refused.value)) < 500
    buses = ["can0", *(f"{k}" * 4096 for k in range(5))]
    assert Log(named(buses)).can_channels == tuple(buses)


# -- what is no file -----------------------------------------------------------------------------------------


def test_a_pipe_is_refused_and_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "pipe.mcap")
    with pytest.raises(LogError, match="not a regular file"):
        Log(tmp_path / "pipe.mcap")
    with pytest.raises(LogError, match="not a regular file"):
        salvage(tmp_path / "pipe.mcap", tmp_path / "out.mcap")


# -- salvage -------------------------------------------------------------------------------------------------


def whole_again(bad, tmp_path):
    report = salvage(bad, tmp_path / "out.mcap")
    return report, Log.open(tmp_path / "out.mcap")


def test_a_flipped_bit_in_the_name_of_a_schema_loses_nothing(path, damaged, tmp_path):
    bad = damaged(path.read_bytes().index(FRAME.encode()), bytes([FRAME.encode()[0] ^ 0x80]))
    with pytest.raises(LogError, match="not UTF-8"):
        Log(bad)
    report, log = whole_again(bad, tmp_path)
    assert report.ticks == COUNT
    assert not report.complete
    assert_same(log.ticks(), TICKS)
    rewrite_log(tmp_path / "out.mcap", tmp_path / "again.mcap")  # another reader finds all of it, too
    assert_same(Log.open(tmp_path / "again.mcap").ticks(), TICKS)


def test_schemas_without_a_copy_are_made_anew(path, tmp_path):
    content = path.read_bytes()
    for name in (b"hil.Frame", b"hil.OperatorCommand", b"hil.Tick"):
        content = content.replace(name, name[:-1] + b"x", 1)
    bad = tmp_path / "bad.mcap"
    bad.write_bytes(content[: content.rindex(struct.pack("<BQ", container.DATA_END, 4))])
    _, log = whole_again(bad, tmp_path)
    assert_same(log.ticks(), TICKS)
    rewrite_log(tmp_path / "out.mcap", tmp_path / "again.mcap")
    with (tmp_path / "again.mcap").open("rb") as file:
        decoded = make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages("/tick")
        assert [m.tick for _, _, _, m in decoded] == list(range(COUNT))


@pytest.mark.parametrize("length", [1 << 40, 10_000_000, 150_000, 5000])
def test_a_damaged_length_of_a_chunk_loses_this_chunk_alone(path, damaged, chunks, tmp_path, length):
    chunk = chunks[1]
    bad = damaged(chunk.chunk_start_offset + 1, struct.pack("<Q", length))
    with pytest.raises(LogError, match=r"damaged at byte \d+: .*--salvage"):
        Log(bad).rows()
    report, log = whole_again(bad, tmp_path)
    assert report.chunks == len(chunks) - 1
    assert report.bytes_lost == chunk.chunk_length
    kept = log.rows()["tick"]
    lost = sorted(set(range(COUNT)) - set(kept.tolist()))
    assert lost
    assert lost == list(range(lost[0], lost[-1] + 1))


def test_the_ticks_of_a_damaged_chunk_are_counted(path, damaged, chunks, tmp_path):
    middle = chunks[1].chunk_start_offset + chunks[1].chunk_length // 2
    byte = path.read_bytes()[middle]
    report, log = whole_again(damaged(middle, bytes([byte ^ 0x40])), tmp_path)
    assert report.ticks_lost == COUNT - len(log.rows()) > 0
    assert report.bytes_lost == chunks[1].chunk_length
    assert log.metadata["salvage"]["ticks_lost"] == str(report.ticks_lost)


def test_zeros_in_the_middle_are_passed_over(damaged, chunks, tmp_path):
    report, log = whole_again(damaged(chunks[1].chunk_start_offset - 50, bytes(4096)), tmp_path)
    assert report.chunks == len(chunks) - 1
    assert len(log.rows()) == report.ticks < COUNT


def test_a_salvage_that_fails_leaves_nothing(path, tmp_path, monkeypatch):
    monkeypatch.setattr(
        "hil.record.mcap_file.McapFile.finish", lambda self: (_ for _ in ()).throw(OSError(28, "full"))
    )
    with pytest.raises(LogError, match=r"out\.mcap: cannot be written: full"):
        salvage(path, tmp_path / "out.mcap")
    assert list(tmp_path.iterdir()) == []


def test_reading_ends_where_no_record_is(tmp_path):
    """A file system leaves zeros: no kind of record has that number."""
    whole = MAGIC + record_bytes(Metadata(name="a", metadata={"a": "1"}))
    path = tmp_path / "zeros.mcap"
    path.write_bytes(whole + bytes(40))
    *_, last = found = list(records(path))
    assert len(found) == 2
    assert (last.opcode, last.complete) == (NOTHING, False)
    assert last.offset == len(whole)


def test_figures_are_not_taken_from_an_index_in_which_a_bit_has_turned_over(path, damaged):
    content = path.read_bytes()
    (at,) = struct.unpack_from("<Q", content, len(content) - len(MAGIC) - 20)
    whole = Log(path).summary
    assert whole.ticks == COUNT
    tried = 0
    while content[at] != container.FOOTER:
        (length,) = struct.unpack_from("<Q", content, at + 1)
        last = at + 8 + length
        with pytest.raises(LogError, match="damaged"):
            _ = Log(damaged(last, bytes([content[last] ^ 1]))).summary
        tried += 1
        at = last + 1
    assert tried > 10
    assert Log(path).summary == whole
