"""Runs with an operator's commands, and logs with one altered command."""

import numpy as np

import hil
from drivers.signals import Mode

WITHIN = 500
"""Ticks within which a replay must detect the change."""


def simulated(tmp_path, commands, **changes):
    log = tmp_path / f"{len(list(tmp_path.iterdir()))}.mcap"
    run = hil.sim("virtual", commands=commands, log=log, plant_log=False, **changes)
    return run, run.log.rows()


def modes(rows):
    return [Mode(int(m)).name for m in rows["mode"][np.flatnonzero(np.diff(rows["mode"], prepend=-1))]]


class Changed:
    """A log with altered orders in one tick; it ends WITHIN ticks later."""

    def __init__(self, log, tick, orders):
        self.log, self.tick, self.orders = log, tick, orders

    def ticks(self):
        for entry in self.log.ticks():
            if int(entry.row["tick"]) > self.tick + WITHIN:
                return
            yield entry._replace(orders=self.orders) if int(entry.row["tick"]) == self.tick else entry
