"""What is shown of a what-if: its plain values, the figures above the tables, and the tables."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from drivers.protocol import Frame
from drivers.signals import Mode
from drivers.tick_columns import ROW
from hil.loop.what_if import Acted, Answer, Latched, OtherFrames
from hil.study.what_if.recorded import OPEN_LOOP
from hil.study.what_if.show import SHOWN, shown, story, summary, tables


def answered(count=6, **columns):
    """Return an answer whose columns differ from zero; each of `columns` by (tick, element) its value."""
    there, here = np.zeros(count, ROW), np.zeros(count, ROW)
    for rows in (there, here):
        rows["tick"] = np.arange(40, 40 + count)
    for name, values in columns.items():
        for (tick, *element), value in values.items():
            here[name][(tick - 40, *element)] = value
    answer = Answer(ticks=count)
    answer.columns.take(here, there, np.arange(count) / 4.0)
    return answer


def test_one_column_that_parts_alone_is_the_first_difference():
    found = summary(answered(tau={(43, 2): 1.5}, mode={(44,): Mode.FAULT}), 4.0)
    assert found["first_tick"] == 43
    assert found["first"] == [
        {
            "tick": 43,
            "time_s": 0.75,
            "column": "tau.leg_2",
            "leg": 2,
            "recorded": "0.0",
            "what_if": "1.5",
            "unit": "N",
        }
    ]
    assert [each["column"] for each in found["columns"]] == ["tau", "mode"]
    assert [each["largest"] for each in found["columns"]] == [1.5, None], "names have no distance"


def test_columns_that_part_in_one_tick_are_all_the_first_difference():
    found = summary(answered(mode={(42,): Mode.TRACKING}, tau={(42, 5): -2.0}, q={(43, 0): 1.0}), 4.0)
    assert found["first_tick"] == 42
    places = {each["column"]: (each["leg"], each["recorded"], each["what_if"]) for each in found["first"]}
    assert places == {"mode": (None, Mode(0).name, "TRACKING"), "tau.leg_5": (5, "0.0", "-2.0")}


def test_an_answer_like_the_log_has_no_first_difference():
    found = summary(answered(), 4.0)
    assert (found["first_tick"], found["first"], found["columns"]) == (None, [], [])
    assert (found["ticks"], found["logged_s"]) == (6, 1.5)
    assert (found["first_frames"], found["what_if_story"]) == (None, None)


def test_warnings_of_a_force_limit_are_apart_from_the_others():
    answer = answered()
    acted = Acted(recorded=1, answered=3, first_tick=41)
    answer.warnings = dict.fromkeys(("LATE", "FORCE_LIMIT", "FORCE_STEP", "FORCE_WINDOW", "BUS"), acted)
    answer.recorded_faults = [Latched(44, 1.0, "STALE")]
    answer.gaps = [(46, 3)]
    found = summary(answer, 4.0)
    fields = {"recorded": 1, "answered": 3, "first_tick": 41}
    assert found["limits"] == dict.fromkeys(("FORCE_LIMIT", "FORCE_STEP", "FORCE_WINDOW"), fields)
    assert found["other_warnings"] == dict.fromkeys(("LATE", "BUS"), fields)
    assert found["recorded_faults"] == [{"tick": 44, "time_s": 1.0, "fault": "STALE"}]
    assert found["gaps"] == ["3 ticks missing from tick 46"]


def result(answer=None, **fields):
    """Return the plain values of an answer with what the command adds."""
    added = {
        "success": True, "log": "run.mcap", "configuration": "virtual", "changed": [], "remarks": [],
        "wall_s": 0.5, "times_real_time": 3.0, "answer_log": None, "picture": None,
    }  # fmt: skip
    return summary(answer or answered(), 4.0) | added | fields


def test_above_the_tables_stands_what_changed_and_what_came_of_it():
    assert shown(result()) == {
        "success": True, "log": "run.mcap", "configuration": "virtual", "changed": "nothing", "ticks": 6,
        "different ticks": 0, "first difference": [],
        "first other frames": "none: every tick would have sent the same", "limits that acted": [],
        "other warnings": None, "faults": [], "answer_log": None, "picture": None, "remarks": None,
        "wall_s": 0.5, "times_real_time": 3.0, "note": OPEN_LOOP,
    }  # fmt: skip
    acted = {"recorded": 0, "answered": 7, "first_tick": 900}
    there = {"recorded": 4, "answered": 2, "first_tick": None}
    found = shown(result(limits={"FORCE_LIMIT": acted}, other_warnings={"LATE": there}, remarks=["cut"]))
    assert found["limits that acted"] == [
        "FORCE_LIMIT in 7 ticks, in the log in 0, first of its own at tick 900"
    ]
    assert (found["other warnings"], found["remarks"]) == (["LATE in 2 ticks, in the log in 4"], ["cut"])


@pytest.mark.parametrize(("count", "more"), [(1, []), (SHOWN, []), (SHOWN + 1, ["and 1 more"])])
def test_a_terminal_shows_a_dozen_changes(count, more):
    names = [f"key_{n}: 1 -> 2" for n in range(count)]
    assert shown(result(changed=names))["changed"] == [*names[:12], *more]


@pytest.mark.parametrize(("count", "more"), [(1, []), (3, []), (4, ["1 more columns"])])
def test_a_terminal_shows_the_first_difference_of_three_columns(count, more):
    first = [
        {"tick": 43, "time_s": 0.7503, "column": f"tau.leg_{n}", "recorded": n, "what_if": -n, "unit": unit}
        for n, unit in zip(range(count), ("N", "", "N", "N"), strict=False)
    ]
    words = [
        "tick 43 (0.750 s): tau.leg_0: recorded 0, what-if 0 N",
        "tick 43 (0.750 s): tau.leg_1: recorded 1, what-if -1",
        "tick 43 (0.750 s): tau.leg_2: recorded 2, what-if -2 N",
    ]
    assert shown(result(first=first))["first difference"] == [*words[:count], *more]


@pytest.mark.parametrize(
    ("legs", "whom"),
    [((0, 1, 2, 3, 4, 5), "all legs"), ((3,), "leg 3"), ((0, 4), "leg 0, 4"), ((), "no leg")],
)
def test_the_first_other_frames_say_for_whom_they_are(legs, whom):
    answer = answered()
    answer.first_frames = OtherFrames(
        43, 0.75, Frame(0x81, bytes((1, 0xAB))), Frame(0x81, bytes((2, 0xCD))), legs
    )
    found = result(answer)
    assert found["first_frames"]["legs"] == list(legs)
    assert shown(found)["first other frames"] == (
        f"tick 43 (0.750 s), for {whom}: recorded 0x81 01 ab, what-if 0x81 02 cd"
    )


@pytest.mark.parametrize(
    ("there", "here", "said"),
    [
        (None, Frame(0x2A, b"\x05"), "recorded none, what-if 0x2A 05"),
        (Frame(0x2A, b"\x05"), None, "recorded 0x2A 05, what-if none"),
    ],
)
def test_a_frame_that_only_one_of_the_two_sends_stands_against_none(there, here, said):
    answer = answered()
    answer.first_frames = OtherFrames(43, 0.75, there, here, (1,))
    assert shown(result(answer))["first other frames"].endswith(f"for leg 1: {said}")


def test_faults_of_both_sides_are_named_each_once_and_where_they_part():
    own: list[Any] = [{"fault": "SPEED", "tick": 42}, {"fault": "SPEED", "tick": 42}]
    there = [{"fault": "STALE", "tick": 44}]
    assert shown(result(what_if_faults=own))["faults"] == ["what-if: SPEED at tick 42", "recorded: none"]
    assert shown(result(recorded_faults=there))["faults"] == ["what-if: none", "recorded: STALE at tick 44"]
    parted = result(what_if_faults=own, recorded_faults=there, faults_part_at_tick=42)
    parted["forces"]["ticks"] = 2
    assert shown(parted)["faults"] == [
        "what-if: SPEED at tick 42",
        "recorded: STALE at tick 44",
        "from tick 42 on one of the two has faulted and the other not: 2 ticks are compared until then",
    ]


def lines(printed):
    return [line.split() for line in printed.readouterr().out.splitlines()]


def test_the_tables_have_each_leg_and_each_column_that_differs(capsys):
    answer = answered(tau={(43, 2): 1.5, (44, 2): -4.25}, mode={(44,): Mode.FAULT})
    answer.different_ticks = 2
    answer.forces.take(np.arange(40, 44), np.arange(24.0).reshape(4, 6) * [1, 0, -1, 2, 3, 4])
    found = result(answer)
    tables(found)
    force, titles, *legs, columns, tau, mode = lines(capsys)
    assert " ".join(force) == "force, what-if less recorded, over 4 of 6 ticks:"
    assert " ".join(titles) == "leg largest N at tick RMS N"
    rms = [np.sqrt(np.mean([(row * 6 + leg) ** 2 for row in range(4)])) for leg in range(6)]
    gains = (1, 0, 1, 2, 3, 4)
    assert [row[0] for row in legs] == list("012345")
    assert [float(row[1]) for row in legs] == [18, 0, 20, 42, 66, 92]
    assert [row[2] for row in legs] == ["43", "-", "43", "43", "43", "43"]
    assert [float(row[3]) for row in legs] == pytest.approx(np.multiply(rms, gains), rel=1e-3)
    assert " ".join(columns) == "column from tick in ticks largest unit at tick"
    assert tau == ["tau", "43", "2", "4.25", "N", "44"]
    assert mode == ["mode", "44", "1", "-", "44"]


def test_forces_alone_differ_in_no_column_and_without_a_difference_there_is_no_table(capsys):
    answer = answered()
    tables(result(answer))
    assert lines(capsys) == []
    answer.different_ticks = 1  # of sent frames alone
    tables(result(answer))
    heading, titles, *legs = capsys.readouterr().out.splitlines()
    assert heading.startswith("force, ")
    assert titles.startswith("leg ")
    assert [line[:4] for line in legs] == [f"  {leg} " for leg in range(6)]


@pytest.mark.parametrize(("count", "more"), [(SHOWN, 0), (SHOWN + 2, 1)])
def test_a_terminal_shows_a_dozen_columns_and_says_how_many_more_there_are(capsys, count, more):
    each = {
        "column": "tau",
        "first": {"tick": 40},
        "at": {"tick": 41},
        "ticks": 1,
        "largest": 1.0,
        "unit": "N",
    }
    tables(result(columns=[each] * count, different_ticks=1))
    said = lines(capsys)
    assert sum(line[0] == "tau" for line in said) == 12
    assert [" ".join(line) for line in said[8 + 1 + 12 :]] == [
        "2 more columns differ: --json FILE has all"
    ] * more


def test_the_story_of_a_what_if_stands_below_its_heading():
    assert list(story(result())) == []
    told = result(what_if_story={"lines": ["leg 3 is slow", "  since tick 4"]})
    assert list(story(told)) == [
        "what the faults of the what-if have to tell:",
        "  leg 3 is slow",
        "    since tick 4",
    ]
