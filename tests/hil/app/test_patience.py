"""The benchmark's patience: what a stall of the host would have ended, counted by hand on short runs."""

import numpy as np
import pytest

from drivers.signals import Mode
from tools.benchmarks.benchmark import Benchmark
from tools.benchmarks.patience import missed, patience_figures, stale

DTYPE = np.dtype([("mode", "i8"), ("skipped", "i8"), ("age", "i8", 6)])


def rows(ages=(), skipped=(), mode=Mode.TRACKING):
    """Rows in which leg 4 is as old as `ages` say."""
    result = np.zeros(max(len(ages), len(skipped)), DTYPE)
    result["mode"] = mode
    result["age"][: len(ages), 4] = ages
    result["skipped"][: len(skipped)] = skipped
    return result


@pytest.mark.parametrize(
    ("ages", "longest", "events"),
    [
        ([0, 1, 2, 3, 4, 0], 4, 0),
        ([0, 4, 5, 6, 0, 4, 5, 0], 6, 2),  # two rises to five, not three ticks
        ([7, 8, 0], 8, 1),  # already over when it begins
        ([0, 0], 0, 0),
        ([], 0, 0),
    ],
)
def test_a_stale_run_counts_once_however_long_it_is(ages, longest, events):
    assert stale(rows(ages), 5) == (longest, events)


@pytest.mark.parametrize(
    ("skipped", "longest", "events"),
    [
        ([0, 4, 0, 4, 0], 4, 0),
        ([0, 3, 2, 0, 9, 0], 9, 2),  # 3 + 2 in a row, then 9
        ([6], 6, 1),
        ([0, 0], 0, 0),
        ([], 0, 0),
    ],
)
def test_missed_periods_add_up_until_a_tick_misses_none(skipped, longest, events):
    assert missed(rows(skipped=skipped), 5) == (longest, events)


def test_what_is_lost_before_the_drives_are_powered_ends_no_run():
    before = rows([9, 9], [9, 9], Mode.IDLE)
    assert stale(before, 5) == (0, 0)
    assert missed(before, 5) == (0, 0)


def test_the_figures_name_both_limits_and_count_with_the_shipped_ones(tmp_path):
    bench = Benchmark(tmp_path, seconds=3.0, memory_minutes=1.0, say=lambda _: None)
    patient, shipped = bench.endless, bench.configuration
    head, ages, periods = patience_figures(rows([0, 150, 0, 6, 0], [0, 4, 0, 0, 0]), patient, shipped)
    assert head.note == (
        "stale_fault_ticks 200, missed_stop_ticks 200, watchdog_ms 200 in place of "
        "stale_fault_ticks 5, missed_stop_ticks 5, watchdog_ms 10"
    )
    assert (ages.values[""], ages.note) == (150.0, "2 times 5 or more, where the shipped limits end a run")
    assert (periods.values[""], periods.note) == (4.0, "never 5 or more, where the shipped limits end a run")
    assert ages.mark is None, "a host that stalls is no mark missed by the loop"
    assert patient.limits.model_dump(exclude={"stale_fault_ticks", "missed_stop_ticks"}) == (
        shipped.limits.model_dump(exclude={"stale_fault_ticks", "missed_stop_ticks"})
    )
