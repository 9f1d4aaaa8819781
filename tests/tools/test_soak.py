"""Some seconds of a soak, across a wrap of the ticks; what each mark of it would notice."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import click
import pytest

from hil.record.log import Log
from tools.benchmarks.figures import Figure
from tools.soak import (
    Memory,
    Shift,
    differences,
    endless,
    figures,
    first_ticks,
    last_hour,
    looks,
    work,
    wraps,
)

RATE_Hz = 1000.0
SECONDS = 2.6


@pytest.fixture(scope="module")
def day(tmp_path_factory):
    """Three shifts in a folder that has room for less: across 16 bits, across 32, and one from tick 0."""
    c = endless("virtual", tmp_path_factory.mktemp("soak"), 0.0695)
    firsts = [2**16 - 2000, 2**32 - 2000, 0]
    return c, [work(c, first, SECONDS) for first in firsts]


def figure(found: list[Figure], name: str) -> Figure:
    (each,) = [f for f in found if f.name == name]
    return each


def test_a_shift_crosses_the_wraps_in_motion_and_its_replay_agrees(day):
    _, shifts = day
    assert [s.crossed for s in shifts] == [["16 bit"], ["16 bit", "31 bit", "32 bit"], []]
    assert [s.trouble for s in shifts] == ["", "", ""]
    across = shifts[1]
    rows = Log.open(across.log).rows()
    assert rows["tick"][0] == across.first
    assert abs(rows["dq"][rows["tick"] == 2**32]).max() > 0.01, "it moves there"
    ticks, different = differences(across)
    assert (ticks, different) == (across.ticks, 0)
    assert ticks > SECONDS * RATE_Hz


def test_old_logs_have_gone_and_the_budget_holds(day):
    c, shifts = day
    assert not shifts[0].log.exists()
    assert shifts[-1].log.exists()
    assert shifts[-1].removed == 1
    assert 0 < shifts[-1].folder_bytes <= c.recording.budget_GB * 1e9
    assert last_hour(shifts, RATE_Hz) == [shifts[2], shifts[1]]


@pytest.mark.long
@pytest.mark.parametrize(
    ("change", "name"),
    [
        ({"trouble": "latched fault"}, "shifts that did not end well"),
        ({"dropped": 1}, "dropped ticks"),
        ({"folder_bytes": 70_000_000}, "logs of the folder"),
        ({"memory": (Memory(100_000, 50_000), Memory(102_200, 50_000))}, "loop, growth in a shift"),
        ({"memory": (Memory(100_000, 50_000), Memory(100_000, 52_200))}, "recorder, growth in a shift"),
    ],
)
def test_each_mark_notices_its_mistake(day, change, name):
    c, (*_, last) = day
    steady = Memory(100_000, 50_000)  # a recorder is still being loaded in a shift of a tenth of a second
    good = replace(last, memory=(steady, steady))
    assert figure(figures([good], c, [(last.ticks, 0)]), name).met is True
    assert figure(figures([replace(good, **change)], c, [(last.ticks, 0)]), name).met is False


@pytest.mark.parametrize(
    ("compared", "replayed", "same"),
    [([(9, 0), (9, 0)], True, True), ([(9, 0), (9, 1)], True, False), ([], False, True)],
)
def test_an_hour_that_differs_or_is_not_there_misses_a_mark(day, compared, replayed, same):
    c, (*_, last) = day
    found = figures([last], c, compared)
    assert (figure(found, "replayed").met, figure(found, "ticks that differ").met) == (replayed, same)


def test_a_log_whose_first_tick_is_another_differs(day):
    _, shifts = day
    ticks, different = differences(replace(shifts[2], first=5))
    assert different > 0.9 * ticks


def test_shifts_begin_a_second_before_each_wrap():
    """25, 50 and 104 days at 1 kHz."""
    firsts = first_ticks(RATE_Hz)
    days = [next(firsts) / RATE_Hz / 86400.0 for _ in range(6)]
    assert days == pytest.approx([0.0, 65.536 / 86400.0, 24.855, 49.710, 104.25, 0.0], abs=2e-3)
    assert list(wraps(RATE_Hz).values()) == sorted(wraps(RATE_Hz).values())


def test_memory_is_looked_at_after_a_quarter_of_a_shift_and_at_its_last_tick():
    assert looks(0, 1000) == (250, 999)
    assert looks(2**32 - 2000, 2**32 + 2000) == (2**32 - 1000, 2**32 + 1999)


def test_the_memory_of_loop_and_recorder_is_that_of_both_looks(day, monkeypatch):
    c, _ = day
    at = iter(range(1000, 9000, 1000))
    monkeypatch.setattr("tools.soak.resident_kB", lambda pid: next(at) + (pid == os.getpid()))
    shift = work(c, 0, 0.2)
    assert shift.memory == (Memory(1001, 2000), Memory(3001, 4000))
    assert shift.grown_MB()[0] == pytest.approx(2000 / 1024)


def test_the_index_that_a_recorder_has_to_hold_is_not_counted_as_growth():
    seen = (Memory(0, 1000), Memory(0, 4000))
    shift = Shift(RATE_Hz, 0, 1, 1.0, Path("none"), 0, 0, 0, "", index_bytes=4000 * 1024, memory=seen)
    assert shift.grown_MB() == pytest.approx((0.0, 0.0))


def test_what_runs_leave_in_the_process_misses_a_mark_above_1_MB(day):
    c, (*_, third) = day
    grown = [replace(third, memory=(Memory(0, 0), Memory(kB, 0))) for kB in (90_000, 100_000, 102_200)]
    name = "process, second shift to last"
    assert figure(figures(grown[:2], c, []), name).met is True
    assert figure(figures(grown, c, []), name).met is False


def test_a_path_that_cannot_repeat_without_an_end_is_refused(tmp_path):
    with pytest.raises(
        click.UsageError, match=r"--configuration lab: reference\.type sinusoids .* waypoints"
    ):
        endless("lab", tmp_path, 1.0)
