"""The table of columns of a log: what it has to have, and how protobuf and its schema show a column."""

import json
from enum import IntEnum, IntFlag
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from google.protobuf.descriptor_pb2 import FileDescriptorSet

from drivers.tick_columns import RECORDED, ROW, Column
from hil.record.layout import RECORD_HEADER
from hil.record.row import TICKS, RowCodec, Table, columns_of, describe, row_schema
from hil.record.schema import message_class
from hil.record.unpack import words_of
from tests.hil.samples import packed_rows


def column(
    name: str, kind: type = int, elements: tuple[str, ...] = (), shape: tuple[int, ...] = ()
) -> Column:
    return Column("output", name, kind, "m", "what it is", elements, shape)


TICK, TIME = column("tick"), column("t_ns")


@pytest.mark.parametrize(("name", "other"), [("tick", TIME), ("t_ns", TICK)])
@pytest.mark.parametrize("instead", ["nothing", "another", "floats", "several"])
def test_a_row_without_the_number_or_the_time_of_its_tick_is_refused(name, other, instead):
    there: dict[str, list[Column]] = {
        "nothing": [],
        "another": [column("count")],
        "floats": [column(name, float), column("count")],
        "several": [column(name, shape=(1,)), column("count")],
    }
    with pytest.raises(ValueError, match=f"the row needs a scalar integer column {name}"):
        Table("/tick", (other, *there[instead])).check()
    with pytest.raises(ValueError, match=f"the row needs a scalar integer column {name}"):
        columns_of(describe((other, *there[instead])))
    Table("/tick", (other, column(name))).check()
    assert columns_of(describe((other, column(name)))) == (other, column(name))


@pytest.mark.parametrize("kind", [int, float])
def test_protobuf_reads_numbers_without_names_as_a_list(kind):
    table = Table(
        "/tick",
        (
            TICK,
            TIME,
            column("A", kind, (), (2, 3)),
            column("b", kind, (), (1,)),
            column("c", kind, ("u", "v"), (2,)),
        ),
    )
    rows = np.zeros(2, table.dtype)
    rows["tick"], rows["A"], rows["b"] = [4, 5], np.arange(12).reshape(2, 2, 3), [[8], [9]]
    rows["c"] = [[21, 22], [23, 24]]
    read = message_class(row_schema(table))
    found = [read.FromString(each) for each in packed_rows(table, rows)]
    assert [(m.tick, list(m.A), list(m.b)) for m in found] == [
        (4, [0, 1, 2, 3, 4, 5], [8]),
        (5, [6, 7, 8, 9, 10, 11], [9]),
    ]
    assert [(m.c.u, m.c.v) for m in found] == [(21, 22), (23, 24)]


def test_the_comments_of_the_fields_stand_on_lines_of_their_own_in_the_order_of_the_fields():
    (file,) = FileDescriptorSet.FromString(row_schema(TICKS).descriptors).file
    places = list(file.source_code_info.location)
    fields = file.message_type[0].field
    assert [list(at.path) for at in places] == [[4, 0, 2, k] for k in range(len(fields))]
    lines = [at.span[0] for at in places]
    assert lines[0] >= 0
    assert all(b > a for a, b in pairwise(lines))
    columns = {c.name: c for c in RECORDED}
    for field, at in zip(fields, places, strict=True):
        c = columns[field.name.removesuffix("_number")]
        assert at.leading_comments == (f" {c.meaning} [{c.unit}]\n" if c.unit else f" {c.meaning}\n")


# -- what a log may say of its columns ----------------------------------------------------------------------

ONE = {
    "name": "x", "type": "int", "flags": False, "names": {}, "unit": "m", "meaning": "what", "elements": [], "shape": [],
}  # fmt: skip
LONG = "é" * 500


def read_with(**changes):
    """Return the last of three columns as it is read, some entries of its description changed."""
    return columns_of(describe_with(**changes))[-1]


def describe_with(**changes):
    return json.dumps([{**ONE, "name": "tick"}, {**ONE, "name": "t_ns"}, {**ONE, **changes}])


@pytest.mark.parametrize("key", ["name", "unit", "meaning", "type", "element"])
def test_each_text_of_a_column_is_a_printable_one_of_at_most_500_signs(key):
    def taken(text):
        if key == "type":
            return read_with(type=text, names={"A": 0}).type.__name__
        if key == "element":
            return read_with(elements=["a", text], shape=[2]).elements[1]
        return getattr(read_with(**{key: text}), key)

    assert taken(LONG) == LONG
    for wrong in (f"{LONG}é", "a\nb", "\x1b[2J", 7, None, ["x"]):
        with pytest.raises((ValueError, TypeError)) as caught:
            taken(wrong)
        assert wrong == ["x"] or "allowed: a printable text of at most 500 signs" in str(caught.value)


@pytest.mark.parametrize("name", ["A", "z9_Z", "b" * 100])
@pytest.mark.parametrize("number", [1, 126])
@pytest.mark.parametrize("flags", [False, True])
def test_values_have_plain_names_and_numbers_from_0_on(name, number, flags):
    kind = read_with(type="Kind", flags=flags, names={"NONE": 0, name: number}).type
    assert issubclass(kind, IntFlag if flags else IntEnum)
    assert kind(number) is kind[name]
    for other, wrong in [
        ("9", number), ("_a", number), ("a-b", number), ("b" * 101, number), ("", number), (f"{name}\n", number),
        (name, -1), (name, 1 << 63), (name, True), (name, float(number)), (name, str(number)), (name, None),
    ]:  # fmt: skip
        with pytest.raises(ValueError, match="allowed: a plain name and a number from 0 on"):
            read_with(type="Kind", flags=flags, names={"NONE": 0, other: wrong})


def test_a_flag_may_be_the_highest_bit_and_there_are_63_of_them():
    names = {f"B{k}": 1 << k for k in range(63)}
    assert list(read_with(type="Bits", flags=True, names=names).names.values()) == [1 << k for k in range(63)]
    make: Any = IntFlag
    more = Column("output", "x", make("More", {f"B{k}": 1 << k for k in range(64)}), "", "")
    with pytest.raises(ValueError, match="column x of the row: at most 63 elements or flags"):
        Table("/tick", (TICK, TIME, more)).check()
    with pytest.raises(ValueError, match="column x of the row: flags are scalar"):
        read_with(type="Bits", flags=True, names={"A": 1}, shape=[1])


@pytest.mark.parametrize("kind", ["int", "float"])
def test_a_column_has_63_elements_with_names_at_most_and_a_name_for_each_or_for_none(kind):
    names = [f"e{k}" for k in range(64)]
    assert read_with(type=kind, elements=names[:63], shape=[63]).elements == tuple(names[:63])
    with pytest.raises(ValueError, match="column x of the row: at most 63 elements or flags"):
        read_with(type=kind, elements=names, shape=[64])
    assert read_with(type=kind, elements=names[:6], shape=[2, 3]).shape == (2, 3)
    assert read_with(type=kind, shape=[64]).size == 64
    for elements in (names[:5], names[:7], names[:1]):
        with pytest.raises(
            ValueError, match=rf"column x: shape \(2, 3\), {len(elements)} names, allowed: rows of"
        ):
            read_with(type=kind, elements=elements, shape=[2, 3])


@pytest.mark.parametrize(
    "names", [{"A": 1, "B": 2}, {"NONE": 0, "A": 127}, {"NONE": 0, "A": 126, "B": 1000}, {"A": 127}]
)
def test_an_enumeration_has_0_and_nothing_that_is_shown_as_a_number_without_a_name(names):
    with pytest.raises(ValueError, match="column x of the row: its enumeration lacks 0, or reaches 127"):
        read_with(type="Kind", names=names)


@pytest.mark.parametrize(
    ("shape", "taken"),
    [
        ([1], True), ([8190], True), ([8191], False), ([65536], False), ([65537], False), ([1, 1, 1, 1], True),
        ([1, 1, 1, 1, 1], False), ([0], False), ([-1], False), ([True], False), ([2.0], False), (["2"], False),
        ([91, 90], True), ([91, 91], False),
    ],
    ids=str,
)  # fmt: skip
def test_a_row_has_64_KiB_and_a_column_four_axes_at_most(shape, taken):
    """Two columns of eight bytes stand in front."""
    if taken:
        assert read_with(shape=shape).shape == tuple(shape)
    else:
        with pytest.raises(ValueError, match="allowed"):
            read_with(shape=shape)
    for wide in ([8189], [8190]):
        text = json.dumps([*json.loads(describe_with(shape=wide)), {**ONE, "name": "y"}])
        if wide == [8189]:
            assert len(columns_of(text)) == 4
        else:
            with pytest.raises(ValueError, match=r"column y: shape .* allowed: rows of 65536 bytes, 4 axes"):
                columns_of(text)


def test_what_is_described_is_read_back_and_rows_of_our_own_have_the_one_type():
    columns = columns_of(describe(RECORDED))
    assert [c._replace(part="output", type=int) for c in RECORDED] == [c._replace(type=int) for c in columns]
    for ours, read in zip(RECORDED, columns, strict=True):
        assert (read.names, read.type.__name__) == (ours.names, ours.type.__name__)
        assert issubclass(read.type, IntFlag) is issubclass(ours.type, IntFlag)
    assert TICKS.dtype is Table("/other", tuple(RECORDED)).dtype is ROW
    assert Table("/tick", columns[:9]).dtype == np.dtype([(c.name, c.kind, c.shape) for c in columns[:9]])


class Kind(IntEnum):
    NONE = 0
    FEW = 3
    MOST = 126


class Bits(IntFlag):
    LOW = 1
    MIDDLE = 4
    HIGH = 1 << 62


def test_a_viewer_sees_the_name_of_a_number_that_has_one_and_the_flags_that_are_set():
    table = Table(
        "/tick", (TICK, TIME, column("kind", Kind), column("bits", Bits), column("several", Kind, (), (2,)))
    )
    table.check()
    numbers = [0, 3, 126, 127, 128, -1, 1 << 40]
    rows = np.zeros(len(numbers), table.dtype)
    rows["kind"] = numbers
    rows["several"] = np.transpose([numbers[::-1], numbers])
    rows["bits"] = [0, 1, 4, 5, 1 << 62, -1, 2]
    codec = RowCodec(table.columns)
    payloads = packed_rows(table, rows)
    schema = row_schema(table)
    found = [message_class(schema).FromString(each) for each in payloads]
    shown = [0, 3, 126, 127, 127, 127, 127]
    assert [m.kind_number for m in found] == numbers
    assert [m.kind for m in found] == shown
    assert [list(m.several) for m in found] == [list(pair) for pair in zip(shown[::-1], shown, strict=True)]
    assert [(m.bits.LOW, m.bits.MIDDLE, m.bits.HIGH) for m in found] == [
        (False, False, False), (True, False, False), (False, True, False), (True, True, False), (False, False, True),
        (True, True, True), (False, False, False),
    ]  # fmt: skip
    words = [words_of(payload)[codec.read - RECORD_HEADER] for payload in payloads]
    assert np.array(words).tobytes() == rows.tobytes()
    (file,) = FileDescriptorSet.FromString(schema.descriptors).file
    nested = {each.name: each for each in file.message_type[0].nested_type}
    values = [(v.name, v.number) for v in nested["kind_type"].enum_type[0].value]
    assert values == [("NONE", 0), ("FEW", 3), ("MOST", 126), ("UNNAMED", 127)]
    assert [(f.name, f.number) for f in nested["bits_type"].field] == [("LOW", 1), ("MIDDLE", 2), ("HIGH", 3)]
