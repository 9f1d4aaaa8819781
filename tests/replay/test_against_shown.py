"""What a terminal shows of two compared logs: a line a column that differs, and where the first one parts."""

from __future__ import annotations

from typing import Any

import pytest
from rich.text import Text

from hil.study.against import show as page
from hil.study.against.show import show, shown


def place(tick, time_s, element, unit, here, there):
    return {"tick": tick, "time_s": time_s, "element": element, "unit": unit, "log": here, "other": there}


def column(name, unit, first, at, **fields):
    exact = {"tolerance": 0.0, "relative_tolerance": 0.0, "diverges": first is not None, "ticks": 0}
    return {"column": name, "unit": unit, "first": first, "at": at, "largest": 0.0} | exact | fields


FORCE = column(
    "tau",
    "N",
    place(700, 0.69949, "tau.leg_2", "N", "1000.123456789", "-2.5e-07"),
    place(702, 0.702, "tau.leg_5", "N", "0.0", "1234.5678"),
    tolerance=0.5,
    ticks=3,
    largest=1234.5678,
)
NEAR = column(
    "q", "m", None, place(9, 0.009, "q.leg_1", "m", "1.0", "1.1"), relative_tolerance=1e-9, largest=2e-10
)
MODE = column(
    "mode",
    "",
    place(701, 0.701, "mode", "", "TRACKING", "STOPPING"),
    place(701, 0.701, "mode", "", "TRACKING", "STOPPING"),
    ticks=1,
    largest=None,
)
FREE = column(
    "compute_ns",
    "ns",
    None,
    place(0, 0.0, "compute_ns", "ns", "7", "8"),
    tolerance="not judged",
    relative_tolerance=1e-9,
    largest=1.0,
)
BOTH: dict[str, Any] = {
    "success": False,
    "log": "a.mcap",
    "against": "b.mcap",
    "align": "tick",
    "ticks_compared": 800,
    "columns_compared": 60,
    "only_in_log": {"ticks": 0, "first": None},
    "only_in_other": {"ticks": 0, "first": None},
    "columns_only_in_log": [],
    "columns_only_in_other": [],
    "columns_of_another_type": [],
    "diverging": ["tau", "mode"],
    "columns": [NEAR, FORCE, MODE, FREE],
}
SHOWN = {
    "success": False,
    "log": "a.mcap",
    "against": "b.mcap",
    "ticks compared": 800,
    "columns compared": 60,
    "first divergence": "tick 700 (0.699 s): tau.leg_2: 1000.123456789, other -2.5e-07 N",
    "diverging columns": 2,
}


@pytest.fixture
def printed(monkeypatch):
    """Give the tables that `show` prints."""
    tables: list[Any] = []
    monkeypatch.setattr(page, "print_table", tables.append)
    return tables


def test_each_column_that_differs_has_a_line_and_those_beyond_their_tolerance_are_red(printed):
    show(BOTH)
    (table,) = printed
    cells = list(zip(*(each.cells for each in table.columns), strict=True))
    assert [str(each.header) for each in table.columns] == [
        *("column", "first tick", "s", "log", "other"),
        *("in ticks", "largest", "at tick", "allowed", "unit"),
    ]
    assert [tuple(map(str, row)) for row in cells] == [
        ("q", "-", "-", "-", "-", "0", "2e-10", "9", "1e-09 relative", "m"),
        ("tau.leg_2", "700", "0.699", "1000.12", "-2.5e-07", "3", "1235", "702", "0.5", "N"),
        ("mode", "701", "0.701", "TRACKING", "STOPPING", "1", "-", "701", "exact", ""),
        ("compute_ns", "-", "-", "-", "-", "0", "1", "0", "any", "ns"),
    ]
    assert [{str(cell.style) for cell in row} for row in cells] == [{""}, {"red"}, {"red"}, {""}]
    assert [each.justify for each in table.columns] == ["left", *["right"] * 8, "left"]


def test_no_table_is_printed_of_logs_without_a_difference(printed):
    show(BOTH | {"columns": [], "diverging": []})
    assert printed == []


def test_the_table_reaches_standard_output(capsys):
    show(BOTH)
    said = capsys.readouterr().out.splitlines()
    assert len(said) == 5
    assert [line.partition(" ")[0] for line in said] == ["column", "q", "tau.leg_2", "mode", "compute_ns"]
    assert said[2].split() == [
        "tau.leg_2",
        *["700", "0.699", "1000.12", "-2.5e-07", "3", "1235", "702", "0.5", "N"],
    ]


def test_above_it_stands_where_the_first_column_beyond_its_tolerance_parts():
    found = shown(BOTH)
    assert found == SHOWN
    assert list(found) == list(SHOWN)
    later = shown(BOTH | {"columns": [NEAR, MODE, FORCE]})
    assert later["first divergence"] == "tick 701 (0.701 s): mode: TRACKING, other STOPPING"
    within = shown(BOTH | {"success": True, "columns": [NEAR, FREE], "diverging": []})
    assert (within["success"], within["diverging columns"]) == (True, 0)
    assert "first divergence" not in within


@pytest.mark.parametrize(("element", "unit"), [("twist.vz", "m/s"), ("twist.wx", "rad/s")])
def test_the_first_divergence_has_the_unit_of_its_own_element(element, unit):
    """A column of several units has none."""
    first = place(3, 0.003, element, unit, "1.0", "2.0")
    twist = column("twist", "", first, first, ticks=1, largest=1.0)
    found = shown(BOTH | {"columns": [twist], "diverging": ["twist"]})
    assert found["first divergence"] == f"tick 3 (0.003 s): {element}: 1.0, other 2.0 {unit}"


def test_an_alignment_by_motion_is_said():
    assert shown(BOTH | {"align": "motion"}) == SHOWN | {"aligned by": "the first motion"}


@pytest.mark.parametrize(
    ("key", "value", "name", "said"),
    [
        ("only_in_log", {"ticks": 2, "first": 7}, "ticks only in the log", "2, the first 7"),
        ("only_in_other", {"ticks": 1, "first": 0}, "ticks only in the other", "1, the first 0"),
        ("columns_only_in_log", ["age", "p"], "columns only in log", "age, p"),
        ("columns_only_in_other", ["condition"], "columns only in other", "condition"),
        ("columns_of_another_type", ["tau", "q"], "columns of another type", "tau, q"),
    ],
)
def test_what_only_one_log_has_is_said_where_there_is_such(key, value, name, said):
    assert shown(BOTH | {key: value}) == SHOWN | {name: said}


@pytest.mark.parametrize(
    ("value", "said"),
    [
        ("12345678901234", "12345678901234"),
        ("-7", "-7"),
        ("1234567.891", "1.23457e+06"),
        ("-0.0", "-0"),
        ("5e-324", "4.94066e-324"),
        ("1e+300", "1e+300"),
        ("nan", "nan"),
        ("LATE|BUS", "LATE|BUS"),
        ("some.name", "some.name"),
    ],
)
def test_a_float_is_shown_to_six_digits_and_a_whole_number_or_a_name_as_it_is(printed, value, said):
    here, there = (column("x", "", place(1, 0.0, "x", "", *pair), place(1, 0.0, "x", "", *pair))
                   for pair in ((value, "1"), ("1", value)))  # fmt: skip
    show({"columns": [here, there]})
    assert [list(each.cells) for each in printed[0].columns[3:5]] == [
        [Text(said), Text("1")],
        [Text("1"), Text(said)],
    ]
