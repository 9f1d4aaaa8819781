"""Which row of the plant's log belongs to which tick, and which two logs are of one run."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from drivers.errors import LogError
from hil.record.data_frame import plant_rows_of, require_one_run
from hil.record.schema import CONFIGURATION, IDENTITY, RUN

PERIOD_NS = 1_000_000
CLOCK_NS = 10_000_000_000
"""The clocks of one run started at most so far apart."""
EPOCH = 946_684_800_000_000_000
PLACES = np.array([0, 1])


def log(
    path, *, epoch_ns=EPOCH, lockstep=True, configuration: bytes | None = b"x: 1\n", run: str | None = "7"
):
    """What of a log says which run it is of."""
    made: Any = SimpleNamespace(
        path=path,
        epoch_ns=epoch_ns,
        lockstep=lockstep,
        attachments={CONFIGURATION: configuration} if configuration else {},
        metadata={IDENTITY: {RUN: run} if run else {}},
    )
    return made


LOG = log("a.mcap")


def ticks_at(t_ns, lateness_ns=0):
    rows = np.zeros(len(t_ns), [("t_ns", np.int64), ("lateness_ns", np.int64)])
    rows["t_ns"], rows["lateness_ns"] = t_ns, lateness_ns
    return rows


def plant_at(t_ns, syncs):
    rows = np.zeros(len(t_ns), [("t_ns", np.int64), ("syncs", np.int64)])
    rows["t_ns"], rows["syncs"] = t_ns, syncs
    return rows


def test_the_row_of_a_tick_is_that_in_which_its_sync_was_counted_and_no_nearer_one():
    plant = plant_at([0, 400_000, 950_000, 1_200_000], [1, 1, 1, 2])
    found = plant_rows_of(ticks_at([0, PERIOD_NS], lateness_ns=10_000), plant, PERIOD_NS)
    assert found.tolist() == [0, 3]


def test_a_late_tick_is_looked_for_where_its_sync_went_out():
    plant = plant_at([0, 1_000_000, 1_700_000], [1, 1, 2])
    late = ticks_at([0, PERIOD_NS], lateness_ns=[0, 700_000])
    assert plant_rows_of(late, plant, PERIOD_NS).tolist() == [0, 2]


def test_without_a_period_it_is_the_usual_distance_of_the_ticks_and_a_single_one_has_its_nearest_row():
    plant = plant_at([0, 900_000, 3_100_000, 5_000_000], [1, 2, 3, 4])
    assert plant_rows_of(ticks_at([0, PERIOD_NS, 2 * PERIOD_NS, 5 * PERIOD_NS]), plant, None).tolist() == [
        0, 1, -1, 3,
    ]  # fmt: skip
    assert plant_rows_of(ticks_at([2 * PERIOD_NS]), plant, None).tolist() == [2]
    assert plant_rows_of(ticks_at([3 * PERIOD_NS, 4 * PERIOD_NS]), plant, None).tolist() == [2, -1]


@pytest.mark.parametrize("gap", [0, 3, 7], ids=["first", "middle", "last"])
def test_a_gap_between_two_ticks_widens_no_ticks_reach_wherever_it_stands(gap):
    steps = np.full(8, PERIOD_NS)
    steps[gap] = 10 * PERIOD_NS
    t_ns = np.concatenate(([0], np.cumsum(steps)))
    far = plant_at([t_ns[gap] + 3 * PERIOD_NS // 4], [1])
    assert plant_rows_of(ticks_at(t_ns), far).tolist() == [-1] * len(t_ns)


@pytest.mark.parametrize(("away_ns", "place"), [(PERIOD_NS // 2, 1), (PERIOD_NS // 2 + 1, -1)])
def test_half_a_period_away_is_still_a_ticks_own_row_and_no_more(away_ns, place):
    plant = plant_at([0, PERIOD_NS + away_ns], [1, 2])
    assert plant_rows_of(ticks_at([0, PERIOD_NS]), plant, PERIOD_NS).tolist() == [0, place]


def test_two_ticks_never_have_one_row():
    found = plant_rows_of(ticks_at([0, PERIOD_NS // 4]), plant_at([10], [1]), PERIOD_NS)
    assert found.tolist() == [0, -1]


def test_a_plant_that_counts_no_sync_is_read_at_its_nearest_row():
    plant = plant_at([0, 900_000, 1_900_000], [0, 0, 0])
    assert plant_rows_of(ticks_at([0, PERIOD_NS, 2 * PERIOD_NS]), plant, PERIOD_NS).tolist() == [0, 1, 2]


@pytest.mark.parametrize("empty", ["ticks", "plant"])
def test_without_rows_no_tick_has_one(empty):
    ticks = ticks_at([] if empty == "ticks" else [0, 1])
    plant = plant_at([] if empty == "plant" else [0], [] if empty == "plant" else [1])
    assert plant_rows_of(ticks, plant).tolist() == [-1] * len(ticks)


@pytest.mark.parametrize(
    "plant",
    [
        {},
        {"epoch_ns": EPOCH + CLOCK_NS},
        {"epoch_ns": EPOCH - CLOCK_NS},
        {"configuration": None},
        {"run": None},
    ],
)
def test_logs_of_one_simulation_belong_together(plant):
    require_one_run(LOG, log("b.mcap", **plant), PLACES)


@pytest.mark.parametrize("places", [[0], [-1, 0], [3, -1], [-1, -1, 2]], ids=str)
def test_one_tick_that_is_in_the_plants_log_is_enough(places):
    require_one_run(LOG, log("b.mcap"), np.array(places))


def test_in_real_time_the_plant_may_have_a_file_of_its_own():
    live: dict[str, Any] = {"lockstep": False, "run": None}
    require_one_run(log("a.mcap", **live), log("b.mcap", configuration=b"y: 2\n", **live), PLACES)


@pytest.mark.parametrize(
    ("plant", "places", "why"),
    [
        ({"epoch_ns": EPOCH + CLOCK_NS + 1}, PLACES, "no tick of a.mcap is in it"),
        ({"epoch_ns": EPOCH - CLOCK_NS - 1}, PLACES, "no tick of a.mcap is in it"),
        ({}, np.array([-1, -1]), "no tick of a.mcap is in it"),
        ({"configuration": b"y: 2\n"}, PLACES, "its configuration is another one"),
        ({"lockstep": False}, PLACES, "its configuration is another one"),
        ({"run": "8"}, PLACES, "set-points, commands or faults were others"),
    ],
)
def test_logs_of_two_runs_are_refused_with_what_differs(plant, places, why):
    with pytest.raises(LogError, match=f"b.mcap is of another run: {why}; name the right one"):
        require_one_run(LOG, log("b.mcap", **plant), places)


def test_a_log_in_real_time_and_a_plant_in_lockstep_are_of_two_runs():
    with pytest.raises(LogError, match="its configuration is another one"):
        require_one_run(log("a.mcap", lockstep=False, run=None), log("b.mcap"), PLACES)


@pytest.mark.parametrize("run", ["7", None])
def test_a_log_of_an_earlier_version_names_no_run(run):
    require_one_run(log("a.mcap", run=run), log("b.mcap", run=None), PLACES)


def test_a_log_without_a_tick_is_of_no_other_run():
    require_one_run(LOG, log("b.mcap"), np.array([], int))


@pytest.mark.parametrize(("tick_ns", "row_ns"), [(50 * PERIOD_NS, PERIOD_NS), (0, 50 * PERIOD_NS)])
def test_a_row_from_long_before_or_after_is_no_ticks_own_although_none_is_nearer(tick_ns, row_ns):
    assert plant_rows_of(ticks_at([tick_ns]), plant_at([row_ns], [1]), PERIOD_NS).tolist() == [-1]
    counted = plant_at([row_ns, row_ns + 10], [0, 0])
    assert plant_rows_of(ticks_at([tick_ns]), counted, PERIOD_NS).tolist() == [-1]


def test_of_two_that_are_equally_near_the_later_one_counts():
    plant = plant_at([PERIOD_NS - 400, PERIOD_NS + 400], [1, 2])
    assert plant_rows_of(ticks_at([PERIOD_NS]), plant, PERIOD_NS).tolist() == [1]
    assert plant_rows_of(ticks_at([0, PERIOD_NS]), plant_at([PERIOD_NS // 2], [1]), PERIOD_NS).tolist() == [
        -1,
        0,
    ]


def test_a_tick_before_the_first_row_and_one_behind_the_last_have_the_one_at_the_end_or_none():
    plant = plant_at([5_000, 2_000_000, 2_500_000], [1, 2, 3])
    ticks = ticks_at([-400_000, 2_000_100, 2_900_000, 9_000_000])
    assert plant_rows_of(ticks, plant, PERIOD_NS).tolist() == [0, 1, 2, -1]


def test_a_plant_whose_count_begins_again_is_read_where_it_rises():
    plant = plant_at([0, 1_000_000, 2_000_000, 3_000_000], [7, 8, 1, 2])
    found = plant_rows_of(ticks_at([0, 1_000_000, 2_000_000, 3_000_000]), plant, PERIOD_NS)
    assert found.tolist() == [0, 1, -1, 3]
