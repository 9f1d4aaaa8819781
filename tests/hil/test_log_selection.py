"""Which rows and columns of a log a selection takes, and what their numbers are called."""

from enum import IntEnum, IntFlag

import numpy as np
import pytest

from drivers.errors import LogError
from drivers.tick_columns import Column
from hil.record.selection import Selection, components, name_of, together

COLUMNS = (
    Column("output", "tick", int, "", "number of the tick"),
    Column("output", "t_ns", int, "ns", "time"),
    Column("output", "q", float, "m", "lengths", (), (3,)),
)


def rows_of(count):
    rows = np.zeros(count, Selection.of(COLUMNS, (), "a.mcap").dtype)
    rows["tick"] = np.arange(count)
    rows["t_ns"] = 10 * rows["tick"]
    rows["q"] = np.arange(3.0 * count).reshape(count, 3)
    return rows


@pytest.mark.parametrize(
    ("span", "ticks"),
    [
        ({"first_ns": 20.0}, [2, 3, 4]),
        ({"last_ns": 20.0}, [0, 1, 2]),
        ({"first_ns": 10.0, "last_ns": 30.0}, [1, 2, 3]),
        ({"first_ns": 30.5}, [4]),
        ({"last_ns": -0.5}, []),
    ],
    ids=str,
)
def test_a_span_includes_both_ends_and_may_have_one(span, ticks):
    selection = Selection.of(COLUMNS, (), "a.mcap")._replace(**span)
    assert selection.within(rows_of(5))["tick"].tolist() == ticks


@pytest.mark.parametrize(
    "names", [("q", "t_ns", "tick"), ("t_ns", "tick", "q"), ("t_ns", "tick"), ("q", "tick", "q")]
)
def test_columns_come_once_in_the_order_requested_with_their_values(names):
    rows = rows_of(4)
    selection = Selection.of(COLUMNS, names, "a.mcap")
    found = together([selection.of_rows(rows[:3]), selection.of_rows(rows[3:])])
    assert found.dtype.names == tuple(dict.fromkeys(names))
    for name in names:
        assert found[name].tolist() == rows[name].tolist()


def test_the_first_unknown_column_is_refused_with_the_log():
    with pytest.raises(LogError, match=r"^a\.mcap: no column 'legs'; there are tick, t_ns, q \.\.\.$"):
        Selection.of(COLUMNS, ("tick", "legs", "arms"), "a.mcap")


@pytest.mark.parametrize(
    ("names", "labels"),
    [
        ([], ["tick", "t_ns", "q.0", "q.1", "q.2"]),
        (["q", "q"], ["q.0", "q.1", "q.2"]),
        (["q.1", "q"], ["q.1", "q.0", "q.2"]),
        (["q.2", "tick", "q.2"], ["q.2", "tick"]),
    ],
)
def test_each_component_comes_once_in_the_order_of_its_first_name(names, labels):
    assert [each.label for each in components(COLUMNS, names, "a.mcap")] == labels


KIND = IntEnum("KIND", {"NONE": 0, "SLOW": 1, "FAST": 4})
BITS = IntFlag("BITS", {"NONE": 0, "LATE": 1, "LOST": 2, "BOTH": 3, "HOT": 8})


@pytest.mark.parametrize(
    ("kind", "names"),
    [
        (KIND, {0: "NONE", 1: "SLOW", 4: "FAST", 2: "2", -1: "-1"}),
        (
            BITS,
            {
                0: "NONE",
                1: "LATE",
                2: "LOST",
                9: "LATE|HOT",
                3: "LATE|LOST",
                4: "4",
                5: "LATE|4",
                0x39: "LATE|HOT|48",
            },
        ),
    ],
)
def test_a_number_has_the_name_that_its_log_gives_it_or_stands_as_itself(kind, names):
    column = Column("output", "x", kind, "", "")
    assert {number: name_of(column, number) for number in names} == names
