"""The table of columns of a log: what it may describe, and how protobuf shows a column."""

import json
from enum import IntEnum, IntFlag
from typing import Any

import numpy as np
import pytest

from drivers.tick_columns import RECORDED, ROW, Column
from hil.record.row import TICKS, Table, columns_of, describe


def column(name, kind: Any = int, elements: tuple[str, ...] = (), shape: tuple[int, ...] = ()) -> Column:
    return Column("output", name, kind, "m", "what it is", elements, shape)


TICK, TIME = column("tick"), column("t_ns")


@pytest.mark.parametrize(("name", "other"), [("tick", TIME), ("t_ns", TICK)])
@pytest.mark.parametrize("instead", ["nothing", "another", "floats", "several"])
def test_a_row_without_number_or_time_of_its_tick_is_refused(name, other, instead):
    there: dict[str, list[Column]] = {
        "nothing": [],
        "another": [column("count")],
        "floats": [column(name, float), column("count")],
        "several": [column(name, shape=(1,)), column("count")],
    }
    columns = other, *there[instead]
    for read in (Table("/tick", columns).check, lambda: columns_of(describe(columns))):
        with pytest.raises(ValueError, match=f"the row needs a scalar integer column {name}"):
            read()
    assert columns_of(describe((other, column(name)))) == (other, column(name))


def test_a_described_table_is_read_back_and_our_rows_have_one_type():
    """NumPy copies a row at once only where both types are one object: 12 us a tick instead of 120."""
    columns = columns_of(describe(RECORDED))
    assert [c._replace(part="output", type=int) for c in RECORDED] == [c._replace(type=int) for c in columns]
    for ours, read in zip(RECORDED, columns, strict=True):
        assert (read.names, read.type.__name__, read.kind) == (ours.names, ours.type.__name__, ours.kind)
        assert issubclass(read.type, IntFlag) is issubclass(ours.type, IntFlag)
    assert TICKS.dtype is Table("/other", tuple(RECORDED)).dtype is ROW
    part = Table("/tick", columns[:9])
    assert part.dtype is part.dtype
    assert part.dtype == np.dtype([(c.name, c.kind, c.shape) for c in columns[:9]])


ONE = {
    "name": "x", "type": "int", "flags": False, "names": {}, "unit": "m", "meaning": "what", "elements": [], "shape": [],
}  # fmt: skip


def read_with(*more, **changes):
    """Return the last of three columns as it is read, some entries of its description changed."""
    entries = [{**ONE, "name": "tick"}, {**ONE, "name": "t_ns"}, {**ONE, **changes}, *more]
    return columns_of(json.dumps(entries))[2]


@pytest.mark.parametrize("key", ["name", "unit", "meaning", "type", "element"])
def test_each_text_of_a_column_is_printable_and_has_500_characters_at_most(key):
    def taken(text):
        if key == "type":
            return read_with(type=text, names={"A": 0}).type.__name__
        if key == "element":
            return read_with(elements=["a", text], shape=[2]).elements[1]
        return getattr(read_with(**{key: text}), key)

    long = "é" * 500
    assert taken(long) == long
    for wrong in (f"{long}é", "a\nb", "\x1b[2J", 7, None, ["x"]):
        with pytest.raises((ValueError, TypeError)) as caught:
            taken(wrong)
        assert wrong == ["x"] or "allowed: a printable text" in str(caught.value)


@pytest.mark.parametrize("flags", [False, True])
def test_values_have_plain_names_and_numbers_from_0_on(flags):
    for name in ("A", "z9_Z", "b" * 100):
        for number in (1, 126):
            kind = read_with(type="Kind", flags=flags, names={"NONE": 0, name: number}).type
            assert issubclass(kind, IntFlag if flags else IntEnum)
            assert kind(number) is kind[name]
    wrong = [("9", 1), ("_a", 1), ("a-b", 1), ("b" * 101, 1), ("", 1), ("A\n", 1)]
    wrong += [("A", number) for number in (-1, 1 << 63, True, 1.0, "1", None)]
    for name, number in wrong:
        with pytest.raises(ValueError, match="allowed: a plain name and a number from 0 on"):
            read_with(type="Kind", flags=flags, names={"NONE": 0, name: number})


NAMES = [f"e{k}" for k in range(64)]
TAKEN: list[dict[str, Any]] = [
    {"type": "Bits", "flags": True, "names": {f"B{k}": 1 << k for k in range(63)}},
    {"elements": NAMES[:63], "shape": [63]},
    {"elements": NAMES[:6], "shape": [2, 3]},
    {"type": "Kind", "names": {"NONE": 0, "A": 126}},
    *({"shape": shape} for shape in ([], [1], [64], [8190], [1, 1, 1, 1], [91, 90])),
]
REFUSED: list[tuple[dict[str, Any], str]] = [
    ({"type": "Bits", "flags": True, "names": {"A": 1}, "shape": [1]}, "flags are scalar"),
    ({"elements": NAMES, "shape": [64]}, "at most 63 elements"),
    *(({"elements": NAMES[:k], "shape": [2, 3]}, rf"shape \(2, 3\), {k} names") for k in (1, 5, 7)),
    *(
        ({"type": "Kind", "names": names}, "its enumeration lacks 0, or reaches 127")
        for names in ({"A": 1}, {"NONE": 0, "A": 127}, {"NONE": 0, "A": 126, "B": 1000})
    ),
    *(
        ({"shape": shape}, "allowed")
        for shape in ([8191], [65536], [65537], [1] * 5, [0], [-1], [True], [2.0], ["2"], [91, 91])
    ),
]
"""Two columns of eight bytes stand in front: a row has 64 KiB at most."""


@pytest.mark.parametrize("changes", TAKEN)
def test_a_column_may_be_as_large_as_this(changes):
    found = read_with(**changes)
    assert found.shape == tuple(changes.get("shape", ()))
    assert found.elements == tuple(changes.get("elements", ()))
    assert found.names == changes.get("names", {})


@pytest.mark.parametrize(("changes", "says"), REFUSED)
def test_a_column_beyond_its_limits_is_refused(changes, says):
    with pytest.raises(ValueError, match=f"column x.*{says}" if says != "allowed" else says):
        read_with(**changes)


def test_all_columns_together_have_64_KiB_and_flags_63_bits():
    last = {**ONE, "name": "y"}
    assert read_with(last, shape=[8189]).shape == (8189,)
    with pytest.raises(ValueError, match=r"column y: .* allowed: rows of 65536 bytes"):
        read_with(last, shape=[8190])
    make: Any = IntFlag
    more = Column("output", "x", make("More", {f"B{k}": 1 << k for k in range(64)}), "", "")
    with pytest.raises(ValueError, match="at most 63 elements or flags"):
        Table("/tick", (TICK, TIME, more)).check()
