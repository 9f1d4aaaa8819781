"""Which rows and columns of a log a selection takes."""

import numpy as np
import pytest

from drivers.errors import LogError
from drivers.tick_columns import Column
from hil.record.selection import Selection, components, together

COLUMNS = (
    Column("output", "tick", int, "", "number of the tick"),
    Column("output", "t_ns", int, "ns", "time"),
    Column("output", "q", float, "m", "lengths", (), (3,)),
)
TICKS = np.dtype([("tick", "<i8")])


def rows_of(count):
    rows = np.zeros(count, Selection.of(COLUMNS, (), "a.mcap").dtype)
    rows["tick"] = np.arange(count)
    rows["t_ns"] = 10 * rows["tick"]
    return rows


def test_of_a_log_that_is_wanted_as_it_is_no_row_is_copied():
    rows = rows_of(4)
    selection = Selection.of(COLUMNS, (), "a.mcap")
    assert selection.within(rows) is rows
    assert selection.of_rows(rows) is rows


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
def test_a_span_has_its_first_and_its_last_instant_in_it_and_may_have_one_end(span, ticks):
    selection = Selection.of(COLUMNS, (), "a.mcap")._replace(**span)
    assert selection.within(rows_of(5))["tick"].tolist() == ticks


def test_columns_come_once_each_in_the_order_asked_for_with_the_values_of_their_rows():
    rows = rows_of(3)
    rows["q"] = np.arange(9).reshape(3, 3)
    found = Selection.of(COLUMNS, ("q", "tick", "q"), "a.mcap").of_rows(rows)
    assert found.dtype.names == ("q", "tick")
    assert found["q"].tolist() == [[0.0, 1.0, 2.0], [3.0, 4.0, 5.0], [6.0, 7.0, 8.0]]
    assert found["tick"].tolist() == [0, 1, 2]


def test_of_several_unknown_columns_the_first_is_said_with_the_log():
    with pytest.raises(LogError, match=r"^a\.mcap: no column 'legs'; there are tick, t_ns, q \.\.\.$"):
        Selection.of(COLUMNS, ("tick", "legs", "arms"), "a.mcap")


@pytest.mark.parametrize("names", [("q", "t_ns", "tick"), ("t_ns", "tick", "q"), ("t_ns", "tick")])
def test_columns_that_are_asked_for_in_another_order_than_the_logs_keep_their_own_values(names):
    rows = rows_of(4)
    rows["q"] = np.arange(12.0).reshape(4, 3)
    selection = Selection.of(COLUMNS, names, "a.mcap")
    found = together([selection.of_rows(rows[:3]), selection.of_rows(rows[3:])])
    assert found.dtype.names == names
    assert found["tick"].tolist() == [0, 1, 2, 3]
    assert found["t_ns"].tolist() == [0, 10, 20, 30]


@pytest.mark.parametrize(
    ("names", "labels"),
    [
        ([], ["tick", "t_ns", "q.0", "q.1", "q.2"]),
        (["q"], ["q.0", "q.1", "q.2"]),
        (["q", "q"], ["q.0", "q.1", "q.2"]),
        (["q", "q.1"], ["q.0", "q.1", "q.2"]),
        (["q.1", "q"], ["q.1", "q.0", "q.2"]),
        (["q.2", "tick", "q.2"], ["q.2", "tick"]),
    ],
)
def test_each_component_that_is_named_is_there_once_and_in_the_order_of_its_first_name(names, labels):
    assert [each.label for each in components(COLUMNS, names, "a.mcap")] == labels
