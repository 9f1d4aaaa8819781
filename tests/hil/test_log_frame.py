"""A DataFrame of a log: the memory that it takes."""

import tracemalloc
from pathlib import Path

import numpy as np
import pytest

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
        self.plant = told.get("plant")

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
