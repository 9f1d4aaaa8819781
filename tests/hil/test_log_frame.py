"""A DataFrame of a log: the memory that it takes, and the plant's rows that stand beside the ticks."""

import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.errors import LogError
from drivers.tick_columns import RECORDED, ROW
from hil.app.plant_columns import PLANT
from hil.record.data_frame import data_frame
from tests.hil.samples import random_rows


class Held:
    """A log that is held in memory."""

    origin_ns = 0

    def __init__(self, name, columns, rows, **told):
        self.path, self.columns, self.held = Path(name), columns, rows
        self.metadata = {"hil": told.get("said", {})}
        self.attachments = {"config.yaml": told.get("configuration", b"a: 1\n")}
        self.epoch_ns, self.lockstep = told.get("epoch_ns", 0), told.get("lockstep", True)
        self.plant: Any = told.get("plant")

    def rows(self, *names, start_s=None, stop_s=None):
        t_s = self.held["t_ns"] * 1e-9
        there = (t_s >= (-np.inf if start_s is None else start_s)) & (
            t_s <= (np.inf if stop_s is None else stop_s)
        )
        found = np.empty(np.count_nonzero(there), [(name, ROW_TYPES[name]) for name in names])
        for name in names:
            found[name] = self.held[name][there]
        return found


ROW_TYPES = {name: dtype[name] for dtype in (PLANT.dtype, ROW) for name in dtype.names or ()}


def ticks(t_ns):
    rows = np.zeros(len(t_ns), ROW)
    rows["tick"], rows["t_ns"] = np.arange(len(t_ns)), t_ns
    return rows


def heard(t_ns):
    """Rows of a plant that hears a SYNC in each of them; its height is their number, from 0."""
    rows = np.zeros(len(t_ns), PLANT.dtype)
    rows["t_ns"], rows["syncs"] = t_ns, np.arange(1, len(t_ns) + 1)
    rows["p"][:, 2] = np.arange(len(t_ns))
    return rows


def heights(log, start_s=None, stop_s=None):
    return data_frame(log, ["plant.p.z"], start_s, stop_s, numbers=False)["plant.p.z"].tolist()


# -- memory --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("names", [(), ("q", "R", "wrench.fz")])
def test_a_table_takes_the_memory_of_its_values_and_three_times_as_much_at_no_time(names):
    log = Held("a.mcap", RECORDED, random_rows(1500))
    data_frame(log, names, None, None, numbers=True)
    tracemalloc.start()
    try:
        frame = data_frame(log, names, None, None, numbers=True)
        left, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    values = 8 * frame.shape[0] * frame.shape[1]
    assert left < 1.5 * values
    assert peak < 2.7 * values


# -- the plant -----------------------------------------------------------------------------------------------


def test_a_span_in_which_the_plant_heard_no_tick_is_of_the_run_whichever_end_is_given():
    plant = Held("a-plant.mcap", PLANT.columns, heard([1_000_000]))
    log = Held("a.mcap", RECORDED, ticks([0, 1_000_000, 2_000_000]), plant=plant, said={"rate_Hz": "1000.0"})
    np.testing.assert_array_equal(heights(log), [np.nan, 0.0, np.nan])
    np.testing.assert_array_equal(heights(log, start_s=0.002), [np.nan])
    np.testing.assert_array_equal(heights(log, stop_s=0.0), [np.nan])
    np.testing.assert_array_equal(heights(log, start_s=0.002, stop_s=0.002), [np.nan])


def test_a_plant_that_heard_no_tick_of_a_whole_log_is_of_another_run():
    log = Held("a.mcap", RECORDED, ticks([0, 1_000_000]), said={"rate_Hz": "1000.0"})
    log.plant = Held("b-plant.mcap", PLANT.columns, heard([9_000_000]))
    with pytest.raises(LogError, match=r"b-plant\.mcap is of another run: no tick of a\.mcap is in it"):
        heights(log)


def in_real_time(apart_ns):
    """A log whose plant has a configuration of its own and a clock that began at another instant."""
    epoch = 1_769_860_800_000_000_000
    plant = Held(
        "b-plant.mcap", PLANT.columns, heard([0, 1_000_000]), epoch_ns=epoch + apart_ns, lockstep=False,
        configuration=b"a: 2\n",
    )  # fmt: skip
    return Held("a.mcap", RECORDED, ticks([0, 1_000_000]), epoch_ns=epoch, lockstep=False, plant=plant)


@pytest.mark.parametrize("apart_ns", [0, 10_000_000_000, -10_000_000_000])
def test_in_real_time_a_plant_may_have_another_configuration_and_begin_up_to_10_s_apart(apart_ns):
    assert heights(in_real_time(apart_ns)) == [0.0, 1.0]


@pytest.mark.parametrize("apart_ns", [10_000_000_001, -10_000_000_001])
def test_a_plant_whose_clock_began_more_than_10_s_apart_is_of_another_run(apart_ns):
    with pytest.raises(LogError, match=r"b-plant\.mcap is of another run: no tick of a\.mcap is in it"):
        heights(in_real_time(apart_ns))


@pytest.mark.parametrize(
    ("said", "found"),
    [
        ({"rate_Hz": "1000.0"}, [0.0, np.nan]),
        ({"rate_Hz": "500.0"}, [0.0, 1.0]),
        ({"rate_Hz": "0"}, [0.0, 1.0]),
        ({"rate_Hz": "fast"}, [0.0, 1.0]),
        ({}, [0.0, 1.0]),
    ],
    ids=str,
)
def test_a_tick_has_the_row_half_a_period_away_of_the_rate_that_the_log_says_else_of_the_usual_one(
    said, found
):
    plant = Held("a-plant.mcap", PLANT.columns, heard([500_000, 2_500_001]))
    log = Held("a.mcap", RECORDED, ticks([0, 2_000_000]), plant=plant, said=said)
    np.testing.assert_array_equal(heights(log), found)
