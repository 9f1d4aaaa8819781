"""A run in lockstep whose rows stay in memory: what a test says of the loop alone needs no recorder and no log."""

from __future__ import annotations

from typing import Any

import numpy as np

from drivers.can.bus_time import BitTiming
from hil.app.compose import build_cycle, build_nodes
from hil.app.configuration.bus_budget import bus_budget
from hil.app.configuration.configuration import Configuration
from hil.app.sim.lockstep import Lockstep
from hil.loop.clock import collector_paused
from hil.record.figures import figures
from plant_fmu.faults.plan import FaultPlan


def run(
    configuration: Configuration, faults: FaultPlan | None = None, plant_of: Configuration | None = None
) -> tuple[dict[str, Any], np.ndarray]:
    """Run to the end; return the figures of the run, with `success` as `hil sim` has it, and all rows.

    plant_of: where drives and plant come from, if they are not those of the configuration.
    """
    c = configuration
    rate = c.loop.rate_Hz
    cycle = build_cycle(c, rate, c.drives.watchdog_ms * 1e-3)
    nodes, plant = build_nodes(plant_of or c, faults)
    try:
        timing = None if bus_budget(c.bus, c.drives, c.sensors, rate) is None else BitTiming.of(c.bus)
        lockstep = Lockstep(cycle, nodes, (timing,), c.loop.window_s(rate))
        kept: list[np.ndarray] = []
        with collector_paused():
            ending = lockstep.run(None, lambda inp, opening, out: kept.append(out.row))
    finally:
        plant.close()
    rows = np.array(kept, kept[0].dtype)
    return {"success": ending.success, **figures(rows)}, rows
