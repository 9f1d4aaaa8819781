"""The table of a summary: the unit of each figure, what is yes or no, which part has failed; the ticks of a fault."""

from __future__ import annotations

import pytest

from drivers.signals import Mode
from hil.app.output import figure_rows, last_ticks_table, table


@pytest.mark.parametrize(
    ("key", "name", "unit"),
    [
        ("peak_V_m2_s4", "peak V", "(m/s^2)^2"),
        ("peak_leg_rate_m_s", "peak leg rate", "m/s"),
        ("wake_up_us", "wake up", "us"),
        ("longest_ms", "longest", "ms"),
        ("duration_s", "duration", "s"),
        ("peak_leg_error_mm", "peak leg error", "mm"),
        ("peak_rotation_error_deg", "peak rotation error", "deg"),
        ("peak_force_N", "peak force", "N"),
        ("rate_Hz", "rate", "Hz"),
        ("resident_MB", "resident", "MB"),
        ("bus_load_percent", "bus load", "%"),
    ],
)
def test_a_figure_has_the_whole_unit_of_its_key_and_none_of_it_is_left_in_its_name(key, name, unit):
    assert figure_rows({key: 2.5}) == [(name, f"2.5 {unit}")]
    assert figure_rows({key: 0.0}) == [(name, f"0 {unit}")], "nothing is a figure, too"


@pytest.mark.parametrize(
    ("value", "shown"),
    [
        (True, "yes"),
        (False, "no"),
        (7, "7"),
        (99.94, "99.9"),
        (-99.94, "-99.9"),
        (100.4, "100"),
        (-1234.5, "-1234"),
        ([], "none"),
        (["OFF"], "OFF"),
        (["OFF", "OFF"], "all OFF"),
        (["OFF", "OFF", "ON"], "OFF; OFF; ON"),
        (["ON", "OFF", "OFF"], "ON; OFF; OFF"),
        (["OFF", "ON", "OFF"], "OFF; ON; OFF"),
    ],
)
def test_a_value_is_shown_as_who_reads_it_would_say_it(value, shown):
    assert figure_rows({"x": value}) == [("x", shown)]


def test_a_part_that_failed_is_said_to_have_failed_and_one_that_did_not_is_not():
    summary = {
        "success": False,
        "plant": {"success": False, "a": 1},
        "bench": {"success": True, "a": 2},
        "c": {"a": 3},
    }
    assert figure_rows(summary) == [
        ("plant", "failed"), ("  a", "1"), ("bench", ""), ("  a", "2"), ("c", ""), ("  a", "3"),
    ]  # fmt: skip


@pytest.mark.parametrize("most", ["p50", "p99", "max"])
def test_delays_are_left_out_where_none_was_above_zero(most):
    none = {"p50": 0.0, "p99": 0.0, "max": 0.0}
    assert figure_rows({"compute_us": none}) == []
    assert len(figure_rows({"compute_us": none | {most: 1.0}})) == 1


def test_a_figure_that_is_not_known_takes_no_line_and_no_width():
    assert table({"success": True, "a_very_long_name_of_nothing": None, "ticks": 3}, 80) == ["ticks  3"]


def told(**changes):
    """Return the line of one tick."""
    tick = {
        "tick": 1200, "mode": int(Mode.TRACKING), "lateness_ns": 0, "age": [0] * 6, "q": [0.0] * 6,
        "q_d": [0.0] * 6, "tau": [0.0] * 6,
    }  # fmt: skip
    _, line = last_ticks_table([tick | changes]).splitlines()
    return line.split()


@pytest.mark.parametrize("leg", range(6))
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_ticks_of_a_fault_have_the_largest_error_in_mm_and_force_in_N_of_whichever_leg_and_way(leg, sign):
    q, tau = [1.0] * 6, [0.0] * 6
    q[leg], tau[leg] = 1.0 + sign * 2.5e-3, -sign * 321.0
    assert told(q=q, q_d=[1.0] * 6, tau=tau) == ["1200", "TRACKING", "0", *["0"] * 6, "2.500", "321"]


def test_the_ticks_of_a_fault_have_their_lateness_in_us_and_the_age_of_each_leg():
    found = told(lateness_ns=250_000, age=[0, 1, 2, 3, 999, 123_456], mode=int(Mode.HELD))
    assert found == ["1200", "HELD", "250", "0", "1", "2", "3", "999", "999", "0.000", "0"]


def test_the_ticks_of_a_fault_stand_in_their_order_each_in_a_line():
    tick = {"mode": 0, "lateness_ns": 0, "age": [0], "q": [0.0], "q_d": [0.0], "tau": [0.0]}
    lines = last_ticks_table([tick | {"tick": n} for n in (7, 8, 9)]).splitlines()
    assert [line.split()[0] for line in lines[1:]] == ["7", "8", "9"]
