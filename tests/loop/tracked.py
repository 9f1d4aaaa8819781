"""Runs in lockstep, without a log, of a bench whose platform a tracker sees: rows and truths while tracking."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from drivers.can.bus_time import BitTiming
from drivers.signals import Mode
from hil.app.compose import build_cycle, build_nodes
from hil.app.sim.lockstep import Lockstep
from hil.loop.cycle import Cycle
from hil.loop.run_end import Ending
from plant_fmu.faults.plan import FaultPlan

LATCHED_NS = 75_000
"""SYNC takes so long, and the drives latch when they have heard it."""


class Tracked(NamedTuple):
    """One run."""

    ending: Ending
    cycle: Cycle
    rows: np.ndarray
    truths: list[tuple[int, Any]]
    """For each row the instant at which the drives latched, ns, and what the plant knew then."""


def track(c, *faults, seed=1, seen=lambda cycle, row: None):
    """Run a configuration to its end with a seed of the noise; seen: called with each tick's cycle and row."""
    noise = c.plant.sensors.model_copy(update={"seed": seed})
    c = c.model_copy(update={"plant": c.plant.model_copy(update={"sensors": noise})})
    rate = c.loop.rate_Hz
    cycle = build_cycle(c, rate, c.drives.watchdog_ms * 1e-3)
    nodes, plant = build_nodes(c, FaultPlan(faults, seed))
    lockstep = Lockstep(cycle, nodes, (BitTiming.of(c.bus),), c.loop.window_s(rate))
    rows, truths = [], []

    def observe(inp, opening, out):
        seen(cycle, out.row)
        if cycle.mode is Mode.TRACKING:
            rows.append(out.row)
            truths.append((inp.t_ns + LATCHED_NS, nodes.snapshot()))

    ending = lockstep.run(None, observe)
    plant.close()
    return Tracked(ending, cycle, np.array(rows, rows[0].dtype), truths)
