"""Untrusted logs: every damage is a LogError with its place, and salvage continues after it."""

import json
import struct

import pytest
from mcap.records import Attachment, Metadata

from drivers.errors import LogError
from hil.record.log import Log, Tick
from hil.record.mcap_file import MAGIC, record_bytes
from hil.record.salvage import salvage
from hil.record.schema import FRAME, IDENTITY, message_class, operator_schema
from hil.signals import Operator, Order, SetPoint
from tests.hil.rewrite import mcap_summary, rewrite_log
from tests.hil.samples import assert_same, log_of, random_rows, random_ticks
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
    """Write the log with some bytes replaced and the checksums unchanged; return its path."""

    def write(at, data):
        content = bytearray(path.read_bytes())
        content[at : at + len(data)] = data
        (tmp_path / "bad.mcap").write_bytes(content)
        return tmp_path / "bad.mcap"

    return write


@pytest.fixture
def remade(path, tmp_path):
    """Write the log with other records and valid checksums of data section and index; return its path."""

    def write(change):
        records = change(container.split(path.read_bytes()))
        (tmp_path / "remade.mcap").write_bytes(container.whole(records))
        return tmp_path / "remade.mcap"

    return write


def replaced(records, opcode, content, number=0):
    """Records with one of a kind changed."""
    k = [k for k, (kind, _) in enumerate(records) if kind == opcode][number]
    return [*records[:k], (opcode, content(records[k][1])), *records[k + 1 :]]


@pytest.fixture
def described(path, remade):
    """Write the log with other entries in the metadata of the run; return its path."""

    def write(**changed):
        identity = record_bytes(Metadata(name=IDENTITY, metadata=Log(path).metadata[IDENTITY] | changed))
        return remade(lambda r: replaced(r, container.METADATA, lambda _: identity[9:]))

    return write


# -- files -----------------------------------------------------------------------------------------------------

FOOTER = struct.pack("<BQQQI", container.FOOTER, 20, 0, 0, 0)


@pytest.mark.parametrize(
    ("content", "says"),
    [
        *((MAGIC[:size], f"cut at {size} bytes") for size in range(1, 8)),
        *((MAGIC[: size - 1] + b"x", "not an MCAP file") for size in range(1, 8)),
        *(((MAGIC + bytes(40))[: size - 8] + MAGIC, f"cut at {size} bytes") for size in (8, 16, 43, 44)),
        (MAGIC + FOOTER + MAGIC, "damaged at byte 37: no valid record"),
    ],
)
def test_too_short_file_is_reported_as_truncated_or_as_not_a_log(tmp_path, content, says):
    (tmp_path / "a.mcap").write_bytes(content)
    with pytest.raises(LogError, match=says):
        Log(tmp_path / "a.mcap")


@pytest.mark.parametrize("head", [(0, 5), (container.METADATA, 1 << 40), (container.DATA_END, (1 << 64) - 1)])
def test_invalid_record_in_a_complete_file_is_reported_with_its_place(path, damaged, head):
    end = path.read_bytes().rindex(struct.pack("<BQ", container.DATA_END, 4))
    says = f"bad.mcap: damaged at byte {end}: no valid record.*; run `hil replay --salvage`"
    with pytest.raises(LogError, match=says):
        Log(damaged(end, struct.pack("<BQ", *head)))


@pytest.mark.parametrize("there", [0, 5, 9, 10, 12, 13, 14, 20])
@pytest.mark.parametrize("within", ["summary", "end of the data"])
def test_log_truncated_within_its_last_records_gives_all_its_ticks(path, tmp_path, within, there):
    data = path.read_bytes()
    end = data.index(struct.pack("<I", 7) + b"summary") - 9
    if within != "summary":
        end = data.rindex(struct.pack("<BQ", container.DATA_END, 4))
    (tmp_path / "cut.mcap").write_bytes(data[: end + there])
    log = Log(tmp_path / "cut.mcap")
    assert log.cut
    assert ("summary" in log.metadata) is (within != "summary")
    assert_same(log.ticks(), TICKS)
    report = salvage(tmp_path / "cut.mcap", tmp_path / "out.mcap")
    assert report.ticks == COUNT
    complete = within != "summary" and not 0 < there < 9  # of less than a head nobody knows what it was
    assert (Log(tmp_path / "out.mcap").summary.closed == "clean") is complete


# -- checksums -------------------------------------------------------------------------------------------------


def test_change_in_the_attached_configuration_is_found(path, damaged, remade):
    at = path.read_bytes().index(b"wn_rad_s: 20") + 10
    with pytest.raises(LogError, match=r"damaged at byte \d+: .* attachment 'config.yaml' .* --salvage"):
        Log(damaged(at, b"30"))
    unchecked = remade(lambda r: replaced(r, container.ATTACHMENT, lambda c: c[:-4] + bytes(4)))
    assert Log.open(unchecked).configuration, "a log without checksums must be accepted"


def test_changed_metadata_are_found_by_the_data_section_checksum(path, damaged):
    bad = damaged(path.read_bytes().index(b"can0") + 3, b"1")
    assert Log(bad).can_channel == "can1"
    for read in (lambda: Log.open(bad), lambda: Log(bad).rows()):
        with pytest.raises(LogError, match="checksum of the data section differs"):
            read()


# -- sizes -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("limit", [{"FREE_BYTES": 1000, "MAX_RATIO": 0}, {"MESSAGE_BYTES": 1 << 40}], ids=str)
def test_every_reader_and_salvage_unpack_no_more_than_allowed(path, tmp_path, monkeypatch, limit):
    for name, value in limit.items():
        monkeypatch.setattr(f"hil.record.mcap_read.{name}", value)
    log, says = Log(path), "unpacks to more than"
    for read in (log.rows, lambda: list(log.blocks("q")), lambda: list(log.ticks()), log.events):
        with pytest.raises(LogError, match=says):
            read()
    report = salvage(path, tmp_path / "out.mcap")
    assert report.ticks == 0
    assert any(says in remark for remark in report.remarks)


# -- the metadata of the run -----------------------------------------------------------------------------------


LONG = "x" * 4096


@pytest.mark.parametrize(
    "changed",
    [
        {"can_channels": json.dumps([f"can{k}" for k in range(17)])},
        {"can_channels": json.dumps(["can0", f"{LONG}x"])},
        {"can_channels": json.dumps(["\x07"])},
        {"epoch_ns": "-1"},
        {"epoch_ns": str(1 << 63)},
        {"columns": "[]"},
        {"columns": '[{"name": "tick"}]'},
    ],
    ids=[
        "17 buses",
        "longer name",
        "control character",
        "before 1970",
        "after 2262",
        "no columns",
        "no type",
    ],
)
def test_invalid_metadata_of_a_run_are_refused(described, changed):
    with pytest.raises(LogError, match="metadata record 'hil' cannot be read") as refused:
        Log(described(**changed))
    assert len(str(refused.value)) < 500


@pytest.mark.parametrize(
    ("dropped", "found"), [("44", 44), ("9" * 18, 10**18 - 1), ("9" * 19, 0), ("x", 0), ("-1", 0), ("", 0)]
)
def test_dropped_ticks_are_read_from_plain_digits_of_the_summary(remade, dropped, found):
    end = record_bytes(Metadata(name="summary", metadata={"closed": "clean", "dropped": dropped}))
    log = Log(remade(lambda r: replaced(r, container.METADATA, lambda _: end[9:], -1)))
    assert (log.summary.dropped, log.summary.closed, log.summary.ticks) == (found, "clean", COUNT)


def test_log_without_a_summary_was_closed_in_an_unknown_way(remade):
    log = Log(remade(lambda r: [p for p in r if p[0] != container.METADATA or b"summary" not in p[1][:11]]))
    assert (log.summary.ticks, log.summary.dropped, log.summary.closed) == (COUNT, 0, "unknown")


def test_missing_or_binary_configuration_is_refused(remade):
    log = Log(remade(lambda r: [part for part in r if part[0] != container.ATTACHMENT]))
    assert len(log.rows("tick")) == COUNT
    with pytest.raises(LogError, match=r"no attachment config\.yaml"):
        _ = log.configuration
    other = record_bytes(
        Attachment(log_time=0, create_time=0, name="config.yaml", media_type="", data=b"a: \xff")
    )
    log = Log(remade(lambda r: replaced(r, container.ATTACHMENT, lambda _: other[9:])))
    with pytest.raises(LogError, match=r"attachment config\.yaml is not text"):
        _ = log.configuration


@pytest.mark.parametrize(
    ("command", "tick", "count", "allowed"),
    [
        (Operator.SETPOINT, 1, 5, 6),
        (Operator.SETPOINT, 1, 7, 6),
        (Operator.HOLD, 2, 1, 0),
        (Operator.SPEED, 2, 0, 1),
    ],
)
def test_logged_command_with_a_wrong_number_of_values_is_refused(
    tmp_path_factory, tmp_path, command, tick, count, allowed
):
    first, second, third = random_rows(3)
    orders = Order(Operator.SPEED, (0.5,)), Order(Operator.HOLD)
    ticks = [
        Tick(first, (), (), ()),
        Tick(second, (), (), (), (SetPoint(*range(6)),)),
        Tick(third, (), (), (), (), orders),
    ]
    path = log_of(ticks, tmp_path_factory)
    kind = message_class(operator_schema())

    def numbered(topic, data, sequence):
        message = kind.FromString(data) if topic == "/operator" else None
        if message is None or message.command != command:
            return data
        message.setpoint[:] = [1.0] * count
        return message.SerializeToString()

    rewrite_log(path, tmp_path / "b.mcap", numbered)
    with pytest.raises(LogError, match=rf"command of tick {tick} has {count} numbers, allowed: {allowed}$"):
        list(Log(tmp_path / "b.mcap").ticks())


# -- salvage ---------------------------------------------------------------------------------------------------


def whole_again(bad, tmp_path):
    report = salvage(bad, tmp_path / "out.mcap")
    return report, Log.open(tmp_path / "out.mcap")


def test_salvage_loses_nothing_by_a_flipped_bit_in_a_schema_name(path, damaged, tmp_path):
    bad = damaged(path.read_bytes().index(FRAME.encode()), bytes([FRAME.encode()[0] ^ 0x80]))
    with pytest.raises(LogError, match="checksum of the data section differs"):
        Log.open(bad)
    report, log = whole_again(bad, tmp_path)
    assert report.ticks == COUNT
    assert_same(log.ticks(), TICKS)
    rewrite_log(tmp_path / "out.mcap", tmp_path / "again.mcap")  # another reader finds all of it, too
    assert_same(Log.open(tmp_path / "again.mcap").ticks(), TICKS)


@pytest.mark.parametrize("length", [1 << 40, 10_000_000, 150_000, 5000])
def test_damaged_length_of_a_chunk_loses_this_chunk_only(damaged, chunks, tmp_path, length):
    bad = damaged(chunks[1].chunk_start_offset + 1, struct.pack("<Q", length))
    with pytest.raises(LogError, match=r"damaged at byte \d+: .*--salvage"):
        Log(bad).rows()
    report, log = whole_again(bad, tmp_path)
    assert len(mcap_summary(tmp_path / "out.mcap").chunk_indexes) == len(chunks) - 1
    assert report.bytes_lost < chunks[1].chunk_length + 20_000, "the damaged chunk and its index are lost"
    lost = sorted(set(range(COUNT)) - set(log.rows()["tick"].tolist()))
    assert lost
    assert lost == list(range(lost[0], lost[-1] + 1))
