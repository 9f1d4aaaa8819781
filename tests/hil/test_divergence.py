"""Differences between the rows of two logs."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.tick_columns import COLUMNS, ROW
from hil.record.divergence import ColumnDivergence, Divergence


def rows(count=4, **columns):
    found = np.zeros(count, ROW)
    found["tick"] = np.arange(10, 10 + count)
    for name, values in columns.items():
        found[name] = values
    return found


def compared(one, other, name, tolerance=(0.0, 0.0)):
    found = ColumnDivergence(COLUMNS[name], *tolerance)
    beyond = found.take(one, other, np.arange(len(one), dtype=np.float64) / 2.0)
    assert found.ticks == beyond.sum()
    return found, beyond.tolist()


def test_first_and_largest_difference_of_two_logs_are_reported_with_tick_and_leg():
    tau = np.zeros((4, 6))
    tau[1, 2], tau[1, 5], tau[3, 4] = 0.5, -2.0, 7.0
    found, beyond = compared(rows(tau=tau), rows(), "tau")
    assert beyond == [False, True, False, True]
    assert found.first is not None
    assert found.at is not None
    first, at = found.first, found.at
    assert (first.tick, first.time_s, first.label, first.unit) == (11, 0.5, "tau.leg_5", "N")
    assert (first.one, first.other) == (-2.0, 0.0)
    assert (found.largest, at.tick, at.label) == (7.0, 13, "tau.leg_4")


@pytest.mark.parametrize(
    ("one", "other", "tolerance", "beyond"),
    [
        (1.0, 1.5, (0.5, 0.0), False),
        (1.0, 1.5, (0.499, 0.0), True),
        (1e6, 1e6 + 1.0, (0.0, 1e-6), False),  # relative to the size
        (1e6, 1e6 + 2.0, (0.0, 1e-6), True),
        (-1e6, -1e6 - 1.0, (0.0, 1e-6), False),
        (-1e6, -1e6 - 2.0, (0.0, 1e-6), True),
        (1e-3, 1e-3 + 2e-6, (0.0, 1e-6), True),  # and to 1 where that is less
        (1e-3, 1e-3 + 5e-7, (0.0, 1e-6), False),
        (np.nan, np.nan, (0.0, 0.0), False),
        (np.nan, 1.0, (1e9, 1e9), True),
        (1.0, np.nan, (1e9, 1e9), True),
        (np.nan, 1.0, (np.inf, 0.0), False),
        (np.inf, np.inf, (0.0, 0.0), False),
        (1.0, np.inf, (1.0, 1.0), True),
        (np.inf, -np.inf, (1.0, 1.0), True),
        (-0.0, 0.0, (0.0, 0.0), False),
    ],
)
def test_log_values_are_compared_with_absolute_and_relative_tolerances(one, other, tolerance, beyond):
    _, found = compared(rows(1, condition=one), rows(1, condition=other), "condition", tolerance)
    assert found == [beyond]


def test_integers_beyond_float_precision_are_compared_exactly():
    found, beyond = compared(rows(1, t_ns=2**60 + 1), rows(1, t_ns=2**60), "t_ns")
    assert (beyond, found.largest) == ([True], 1.0)


def test_differences_of_a_column_accumulate_across_blocks():
    found = Divergence([COLUMNS["mode"], COLUMNS["tau"]], {"tau": 3.0})
    for tau, mode in ((1.0, 0), (5.0, 0), (9.0, 5), (4.0, 5)):
        found.take(rows(1, tau=tau, mode=mode), rows(1), np.zeros(1))
    modes, forces = found.columns
    assert (forces.ticks, forces.largest, modes.ticks) == (3, 9.0, 2)
    assert forces.first is not None
    assert forces.first.one == 5.0


def test_diverging_columns_are_sorted_by_their_first_difference():
    mode, tau, q = np.array([0, 0, 1, 1]), np.zeros((4, 6)), np.zeros((4, 6))
    tau[1, 0], q[2, 0] = 1.0, 1.0
    found = Divergence([COLUMNS[name] for name in ("mode", "q", "tau", "dq")])
    found.take(rows(mode=mode, tau=tau, q=q), rows(), np.zeros(4))
    assert [each.column.name for each in found.diverging] == ["tau", "mode", "q"]
    assert [each.column.name for each in found.first] == ["tau"]
    assert [each.column.name for each in found.different] == ["mode", "q", "tau"]


def test_relative_tolerance_applies_to_float_columns_without_a_tolerance_of_their_own():
    found = Divergence([COLUMNS[name] for name in ("age", "q", "tau")], {"tau": 0.5}, 1e-3)
    relative = [(each.absolute, each.relative) for each in found.columns]
    assert relative == [(0.0, 0.0), (0.0, 1e-3), (0.5, 0.0)]
    found = Divergence([COLUMNS[name] for name in ("age", "q", "tau")], {"tau": 0.5}, np.inf)
    assert [each.absolute for each in found.columns] == [np.inf, np.inf, 0.5]


@pytest.mark.parametrize(
    ("parts", "first"),
    [
        ({}, []),
        ({"tau": 2}, ["tau"]),
        ({"tau": 1, "q": 1}, ["q", "tau"]),
        ({"tau": 1, "q": 2}, ["tau"]),
        ({"tau": 0, "q": 3, "mode": 0}, ["mode", "tau"]),
    ],
)
def test_first_diverging_columns_are_all_columns_that_differ_in_the_earliest_tick(parts, first):
    there, here = rows(), rows()
    for name, row in parts.items():
        here[name][row:] = 1
    found = Divergence([COLUMNS[name] for name in ("mode", "q", "tau")])
    found.take(here, there, np.zeros(4))
    assert [each.column.name for each in found.first] == first


@pytest.mark.parametrize("by", [5, -5])
@pytest.mark.parametrize(("tolerance", "beyond"), [(0.0, True), (4.9, True), (5.0, False), (np.inf, False)])
def test_integer_differences_are_compared_with_the_absolute_tolerance(by, tolerance, beyond):
    age = np.zeros((4, 6), np.int64)
    age[2, 4] = by
    found, ticks = compared(rows(age=age), rows(), "age", (tolerance, 0.0))
    assert found.largest == 5.0
    assert ticks == [False, False, beyond, False]


def test_a_larger_difference_within_tolerance_is_not_the_first_divergence():
    one, other = rows(), rows()
    other["tau"][2] = one["tau"][2] = [1e6, 1.0, 2.0, 0.0, 0.0, 0.0]
    one["tau"][2] += [0.5, 0.1, 0.2, 0.0, 0.0, 0.0]
    found, _ = compared(one, other, "tau", (0.0, 1e-6))
    assert found.first is not None
    assert found.at is not None
    assert (found.first.tick, found.first.label) == (12, "tau.leg_2")
    assert (found.at.label, found.largest) == ("tau.leg_0", 0.5)
