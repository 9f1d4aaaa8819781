"""What of a log is refused, at the border of what is taken, and the words for it."""

import errno
import json
import struct
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from mcap.records import Metadata

from drivers.errors import LogError
from drivers.tick_columns import ROW
from hil.record.log import Log, Tick
from hil.record.mcap_file import MAGIC, record_bytes
from hil.record.schema import IDENTITY, message_class, operator_schema
from hil.signals import Operator, Order, SetPoint
from tests.hil.rewrite import rewrite_log
from tests.hil.samples import assert_same, log_of, random_rows
from tools.fuzz import container

ROWS = random_rows(4)
TICKS = [
    Tick(ROWS[0], (), (), (), (), ()),
    Tick(ROWS[1], (), (), (), (SetPoint(1.0, 2.0, 3.0, 4.0, 5.0, 6.0),), ()),
    Tick(ROWS[2], (), (), (), (), (Order(Operator.SPEED, (0.5,)), Order(Operator.HOLD))),
    Tick(ROWS[3], (), (), (), (), ()),
]


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return log_of(TICKS, tmp_path_factory)


@pytest.fixture
def said(path, tmp_path):
    """Write the log with other entries in the metadata of the run; return its path."""

    def write(**changed):
        identity = Metadata(name=IDENTITY, metadata=Log(path).metadata[IDENTITY] | changed)
        parts = container.split(path.read_bytes())
        first = next(k for k, (kind, _) in enumerate(parts) if kind == container.METADATA)
        parts[first] = (container.METADATA, record_bytes(identity)[9:])
        (tmp_path / "said.mcap").write_bytes(container.whole(parts))
        return tmp_path / "said.mcap"

    return write


# -- files ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("size", [8, 16, 43, 44])
def test_a_file_too_short_for_the_record_before_its_end_is_cut_though_it_ends_as_a_whole_one(tmp_path, size):
    (tmp_path / "a.mcap").write_bytes((MAGIC + bytes(40))[: size - 8] + MAGIC)
    with pytest.raises(LogError, match=f"cut at {size} bytes, the end is missing"):
        Log(tmp_path / "a.mcap")


def test_the_shortest_file_that_is_whole_has_a_footer_and_nothing_else(tmp_path):
    content = MAGIC + struct.pack("<BQQQI", container.FOOTER, 20, 0, 0, 0) + MAGIC
    assert len(content) == 45
    (tmp_path / "a.mcap").write_bytes(content)
    with pytest.raises(LogError, match="damaged at byte 37: no record"):
        Log(tmp_path / "a.mcap")


@pytest.mark.parametrize("size", range(1, 8))
def test_a_file_of_some_of_the_first_bytes_is_cut_and_one_of_others_is_no_log(tmp_path, size):
    (tmp_path / "a.mcap").write_bytes(MAGIC[:size])
    with pytest.raises(LogError, match=f"cut at {size} bytes"):
        Log(tmp_path / "a.mcap")
    (tmp_path / "a.mcap").write_bytes(MAGIC[: size - 1] + b"x")
    with pytest.raises(LogError, match="not an MCAP file"):
        Log(tmp_path / "a.mcap")


def test_a_log_whose_size_cannot_be_told_is_said_to_be_unreadable(path, monkeypatch):
    log = Log(path)

    def broken(_: Path) -> None:
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr(Path, "stat", broken)
    with pytest.raises(LogError, match=r"a\.mcap: cannot be read: Input/output error"):
        log.rows()


@pytest.mark.parametrize(
    ("head", "says"),
    [
        (struct.pack("<BQ", 0, 5), "no record"),
        (struct.pack("<BQ", container.METADATA, 1 << 40), "a record that ends behind the file"),
    ],
)
def test_what_stands_where_a_record_of_a_whole_file_should_is_said_with_its_place(path, tmp_path, head, says):
    content = path.read_bytes()
    end = content.rindex(struct.pack("<BQ", container.DATA_END, 4))
    (tmp_path / "bad.mcap").write_bytes(content[:end] + head + content[end + len(head) :])
    with pytest.raises(
        LogError, match=f"bad.mcap: damaged at byte {end}: {says}; run `hil replay --salvage`"
    ):
        Log(tmp_path / "bad.mcap")


@pytest.mark.parametrize("there", [0, 5, 9, 20])
def test_a_log_that_is_cut_within_the_metadata_of_its_end_is_read_without_them(path, tmp_path, there):
    content = path.read_bytes()
    end = content.index(struct.pack("<I", 7) + b"summary") - 9
    assert content[end] == container.METADATA
    (tmp_path / "cut.mcap").write_bytes(content[: end + there])
    log = Log(tmp_path / "cut.mcap")
    assert "summary" not in log.metadata
    assert_same(log.ticks(), TICKS)


# -- the metadata of the run ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("epoch_ns", "taken"), [(-1, False), (0, True), ((1 << 63) - 1, True), (1 << 63, False)]
)
def test_the_instant_0_of_a_log_may_be_any_of_64_bits_from_1970_on(said, epoch_ns, taken):
    path = said(epoch_ns=str(epoch_ns))
    if taken:
        assert Log(path).epoch_ns == epoch_ns
        return
    with pytest.raises(LogError, match=f"metadata record 'hil' cannot be read.*epoch_ns {epoch_ns}"):
        Log(path)


def test_log_may_list_at_most_16_buses(said):
    names = [f"can{k}" for k in range(17)]
    assert Log(said(can_channels=json.dumps(names[:16]))).can_channels == tuple(names[:16])
    with pytest.raises(LogError, match="17 names of buses, allowed: 16 of 4096 signs"):
        Log(said(can_channels=json.dumps(names)))


def test_the_name_of_a_bus_may_have_4096_signs_and_none_more(said):
    long = "x" * 4096
    assert Log(said(can_channels=json.dumps(["can0", long]))).can_channels == ("can0", long)
    with pytest.raises(LogError, match="names of buses, allowed"):
        Log(said(can_channels=json.dumps(["can0", long + "x"])))


# -- commands and figures ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("command", "tick", "count", "allowed"),
    [
        (Operator.SETPOINT, 1, 5, 6),
        (Operator.SETPOINT, 1, 7, 6),
        (Operator.HOLD, 2, 1, 0),
        (Operator.SPEED, 2, 0, 1),
    ],
)
def test_a_command_with_other_numbers_than_it_has_is_refused(path, tmp_path, command, tick, count, allowed):
    kind = message_class(operator_schema())
    changed = []

    def numbered(topic, data, sequence):
        message = kind.FromString(data) if topic == "/operator" else None
        if message is None or message.command != command:
            return data
        message.setpoint[:] = [1.0] * count
        changed.append(command)
        return message.SerializeToString()

    rewrite_log(path, tmp_path / "b.mcap", numbered)
    assert changed == [command]
    says = rf"b\.mcap: the operator's command of tick {tick} has {count} numbers, allowed: {allowed}$"
    with pytest.raises(LogError, match=says):
        list(Log(tmp_path / "b.mcap").ticks())


def test_the_figures_of_a_log_are_those_of_all_its_rows(path, monkeypatch):
    made = SimpleNamespace(figures=lambda rows: {"ticks": rows["tick"].tolist(), "names": rows.dtype.names})
    monkeypatch.setitem(sys.modules, "hil.record.figures", made)
    assert Log(path).figures() == {"ticks": [0, 1, 2, 3], "names": ROW.names}


def test_counts_of_what_the_index_does_not_name_are_0(path, tmp_path):
    parts = container.split(path.read_bytes())
    assert Log(path).summary[:2] == (4, 0)
    end = next(k for k, (kind, _) in enumerate(parts) if kind == container.DATA_END)
    index = [part for part in parts[end:] if part[0] != container.CHANNEL]
    (tmp_path / "b.mcap").write_bytes(container.whole([*parts[:end], *index]))
    assert Log(tmp_path / "b.mcap").summary[:2] == (0, 0)
    assert Log(tmp_path / "b.mcap").rows("tick")["tick"].tolist() == [0, 1, 2, 3]


def test_how_a_log_was_closed_is_unknown_where_its_end_does_not_say_it(path, tmp_path):
    parts = container.split(path.read_bytes())
    kept = [part for part in parts if part[0] != container.METADATA or b"summary" not in part[1][:11]]
    assert len(kept) == len(parts) - 1
    (tmp_path / "b.mcap").write_bytes(container.whole(kept))
    found = Log(tmp_path / "b.mcap").summary
    assert (found.ticks, found.dropped, found.closed) == (4, 0, "unknown")
