"""Table of columns of a log: its allowed content; rows and frames as bytes that protobuf reads."""

from __future__ import annotations

import hashlib
import json
import os
import pickle
import subprocess
import sys
from enum import IntEnum, IntFlag
from typing import Any

import numpy as np
import pytest

from drivers.frame_array import FRAME
from drivers.tick_columns import RECORDED, ROW, Column
from hil.record.encode import TICK, Encoder
from hil.record.layout import RECORD_HEADER
from hil.record.packer import pack
from hil.record.ring import Batch
from hil.record.row import TICKS, Table, columns_of, describe
from hil.record.schema import message_class
from tests.hil.samples import random_rows


def column(name, kind: Any = int, elements: tuple[str, ...] = (), shape: tuple[int, ...] = ()) -> Column:
    return Column("output", name, kind, "m", "what it is", elements, shape)


NUMBER, TIME = column("tick"), column("t_ns")


@pytest.mark.parametrize(("name", "other"), [("tick", TIME), ("t_ns", NUMBER)])
@pytest.mark.parametrize("instead", ["nothing", "another", "floats", "several"])
def test_a_row_without_a_tick_or_t_ns_column_is_refused(name, other, instead):
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


def test_column_table_is_restored_from_its_description_with_the_same_row_type_object():
    """NumPy copies a row at once only if both types are one object: 12 us per tick instead of 120."""
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
    """Last of three columns as read, with some changed entries of its description."""
    entries = [{**ONE, "name": "tick"}, {**ONE, "name": "t_ns"}, {**ONE, **changes}, *more]
    return columns_of(json.dumps(entries))[2]


@pytest.mark.parametrize("key", ["name", "unit", "meaning", "type", "element"])
def test_texts_of_a_column_are_printable_and_at_most_500_characters(key):
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
def test_enumeration_values_need_plain_names_and_numbers_from_0_on(flags):
    for name in ("A", "z9_Z", "b" * 100):
        for number in (1, 126):
            kind = read_with(type="Kind", flags=flags, names={"NONE": 0, name: number}).type
            assert issubclass(kind, IntFlag if flags else IntEnum)
            assert kind(number) is kind[name]
    wrong: list[tuple[str, Any]] = [("9", 1), ("_a", 1), ("a-b", 1), ("b" * 101, 1), ("", 1), ("A\n", 1)]
    wrong += [("A", number) for number in (-1, 1 << 63, True, 1.0, "1", None)]
    for name, number in wrong:
        with pytest.raises(ValueError, match=r"allowed: a (name of letters|whole number)"):
            read_with(type="Kind", flags=flags, names={"NONE": 0, name: number})


NAMES = [f"e{k}" for k in range(64)]
TAKEN: list[dict[str, Any]] = [
    {"type": "Bits", "flags": True, "names": {f"B{k}": 1 << k for k in range(63)}},
    {"elements": NAMES[:63], "shape": [63]},
    {"elements": NAMES[:6], "shape": [2, 3]},
    {"type": "Kind", "names": {"NONE": 0, "A": 126}},
    *({"shape": shape} for shape in ([], [1], [8190], [1, 1, 1, 1], [91, 90])),
]
REFUSED: list[dict[str, Any]] = [
    {"type": "Bits", "flags": True, "names": {"A": 1}, "shape": [1]},
    {"elements": NAMES, "shape": [64]},
    *({"elements": NAMES[:k], "shape": [2, 3]} for k in (1, 5, 7)),
    *({"type": "Kind", "names": names} for names in ({"A": 1}, {"NONE": 0, "A": 127})),
    *({"shape": shape} for shape in ([8191], [65537], [1] * 5, [0], [-1], [True], [2.0], ["2"], [91, 91])),
]
"""Refused columns, after two columns of eight bytes: a row has at most 64 KiB."""


@pytest.mark.parametrize("changes", TAKEN)
def test_a_column_of_the_largest_size_is_accepted(changes):
    found = read_with(**changes)
    assert found.shape == tuple(changes.get("shape", ()))
    assert found.elements == tuple(changes.get("elements", ()))
    assert found.names == changes.get("names", {})


@pytest.mark.parametrize("changes", REFUSED)
def test_a_column_beyond_its_limits_is_refused(changes):
    with pytest.raises(ValueError, match="allowed: "):
        read_with(**changes)


def test_rows_have_at_most_64_KiB_and_flags_at_most_63_bits():
    last = {**ONE, "name": "y"}
    assert read_with(last, shape=[8189]).shape == (8189,)
    with pytest.raises(ValueError, match=r"column y .*: allowed: rows of 65536 bytes"):
        read_with(last, shape=[8190])
    make: Any = IntFlag
    more = Column("output", "x", make("More", {f"B{k}": 1 << k for k in range(64)}), "", "")
    with pytest.raises(ValueError, match="scalar flags of 63 bits"):
        Table("/tick", (NUMBER, TIME, more)).check()


# -- the packer -------------------------------------------------------------------------------------------------

EPOCH, S = 1_700_000_000_123_456_789, 1_000_000_000


def messages_of(encoder, batch, channel):
    """Messages on a channel, serialised again by protobuf."""
    made = encoder.encode(batch)
    kind = message_class(encoder.channels[channel][1])
    parsed = [kind.FromString(bytes(r[RECORD_HEADER:])) for r in made.records() if r[9] == channel]
    return [each.SerializeToString(deterministic=True) for each in parsed]


def row_message(kind, table, row):
    """Message of a row, filled field by field."""
    message = kind()
    for c in table.columns:
        numbers = row[c.name].reshape(-1).tolist()
        name = f"{c.name}_number" if c.names else c.name
        shown = [n if 0 <= n < 127 else 127 for n in numbers] if c.names else []
        if c.elements:
            for element, n in zip(c.elements, numbers, strict=True):
                setattr(getattr(message, name), element, n)
            for element, n in zip(c.elements, shown, strict=bool(shown)):
                setattr(getattr(message, c.name), element, n)
        elif c.shape:
            getattr(message, name).extend(numbers)
            if shown:
                getattr(message, c.name).extend(shown)
        else:
            setattr(message, name, numbers[0])
        if issubclass(c.type, IntFlag):
            for flag, bit in c.names.items():
                setattr(getattr(message, c.name), flag, numbers[0] & bit != 0)
            getattr(message, c.name).SetInParent()
        elif shown and not c.shape:
            setattr(message, c.name, shown[0])
    return message.SerializeToString(deterministic=True)


class Kind(IntEnum):
    NONE = 0
    ONE = 1
    MOST = 126


class Bits(IntFlag):
    LOW = 1
    HIGH = 1 << 62


MANY = tuple(f"e{k}" for k in range(63))
TABLES = (
    (column("a", float, (), (3, 5)), column("b", int, MANY[:15], (15,)), column("c", float, MANY, (63,))),
    (column("kind", Kind), column("bits", Bits), column("kinds", Kind, (), (4,))),
    (column("named", Kind, MANY[:16], (16,)), column("one", float, ("x",), (1,)), column("last")),
)


@pytest.mark.parametrize("columns", TABLES, ids=["numbers", "names", "named elements"])
def test_one_kernel_packs_any_table_of_columns(columns):
    table = Table("/tick", (columns[0], column("t_ns"), *columns[1:], column("tick")))
    table.check()
    rows = random_rows(50, dtype=table.dtype)
    for c in columns:
        if c.names:
            numbers = [0, 1, 126, 127, 128, -1, 1 << 62, 255, 256]
            rows[c.name] = np.resize(numbers, rows[c.name].shape)
    encoder = Encoder(table, epoch_ns=EPOCH, can_channels=["can0"], scene=None)
    kind = message_class(encoder.channels[TICK][1])
    batch = Batch(rows, np.zeros(0, FRAME), np.zeros(0, np.int64))
    assert messages_of(encoder, batch, TICK) == [row_message(kind, table, row) for row in rows]


# -- in a process without Numba ------------------------------------------------------------------------------

OTHER = """
import hashlib, pickle, sys
import numpy as np
from hil.record.encode import Encoder
from hil.record.ring import FRAME, Batch
from hil.record.row import TICKS
import hil.record.recorder
code, rows, items = pickle.load(sys.stdin.buffer)
rows = np.frombuffer(rows, TICKS.dtype)
items = np.frombuffer(items, FRAME)
batch = Batch(rows, items, np.arange(5))
encoder = Encoder(TICKS, epoch_ns=0, can_channels=["can0"], scene=None, packer=code)
print(hashlib.sha256(encoder.encode(batch).data).hexdigest(), "numba" in sys.modules)
"""


@pytest.mark.parametrize("plain", [False, True], ids=["machine code", "plain Python"])
def test_machine_code_and_plain_python_pack_the_same_bytes(plain):
    rows = random_rows(5)
    items = np.frombuffer(np.random.default_rng(1).bytes(5 * FRAME.itemsize), FRAME).copy()
    items["kind"], items["length"], items["bus"] = [0, 1, 0, 1, 0], [0, 8, 64, 3, 12], 0
    items["t_ns"] = np.arange(5) * S
    here = Encoder(TICKS, epoch_ns=0, can_channels=["can0"], scene=None)
    expected = here.encode(Batch(rows, items, np.arange(5))).data
    given = pickle.dumps((None if plain else pack.machine_code, rows.tobytes(), items.tobytes()))
    environment = {**os.environ, **({"NUMBA_DISABLE_JIT": "1"} if plain else {})}
    done = subprocess.run(
        [sys.executable, "-c", OTHER], input=given, capture_output=True,
        env=environment, check=True, timeout=60,
    )  # fmt: skip
    assert done.stdout.decode().split() == [hashlib.sha256(expected.tobytes()).hexdigest(), str(plain)]
