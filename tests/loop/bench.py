"""Lockstep runs, without a log, of configurations with changes."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np

from drivers.signals import Mode
from hil.app.compose import build_cycle, build_nodes
from hil.app.configuration.changes import with_changes
from hil.app.configuration.configuration import Configuration, load, loads
from hil.app.sim.build import build_lockstep
from hil.app.sim.lockstep import Lockstep
from hil.loop.clock import collector_paused
from hil.loop.cycle import Cycle
from hil.loop.run_end import Course, Ending
from hil.record.figures import figures
from hil.signals import Operator, TickInput
from plant_fmu.faults.fault import Fault as PlantFault
from plant_fmu.faults.plan import FaultPlan

LAST = 20_000
"""Longest wait for a mode, in ticks."""


def changed(base: str | Configuration, **sections: Any) -> Configuration:
    """A configuration, shipped or given, with changes as for `hil.sim`: section=keys to change."""
    c = load(base) if isinstance(base, str) else base
    return loads(with_changes(c.text, sections), c.source, c.folder)


def new_cycle(c: Configuration) -> Cycle:
    """The controller of a configuration."""
    return build_cycle(c, c.loop.rate_Hz, c.drives.watchdog_ms * 1e-3)


class Ran(NamedTuple):
    """One run."""

    ending: Ending
    rows: Any
    """One row per tick."""
    true: Any
    """(n, 6) m, the plant's true leg lengths at each tick."""
    cycle: Cycle

    @property
    def summary(self) -> dict[str, Any]:
        """The figures of the run, with `success` as `hil sim` has it."""
        return {"success": self.ending.success, **figures(self.rows)}

    @property
    def tracking(self) -> Any:
        """The rows along the reference."""
        return self.rows[self.rows["mode"] == Mode.TRACKING]

    @property
    def struck(self) -> int:
        """Index of the first row with a fault."""
        return int(np.argmax(self.rows["faults"] != 0))

    def first(self, mode: Mode) -> int:
        """Index of the first row in a mode."""
        return int(np.argmax(self.rows["mode"] == mode))

    def within(self, mode: Mode, share: float = 0.0) -> float:
        """A time within a mode of a run at 1 kHz, s."""
        ticks = np.flatnonzero(self.rows["mode"] == mode)
        return float(1e-3 * (ticks[0] + round(share * len(ticks))))

    def modes(self, since: int = 0) -> list[Mode]:
        """Modes from a row on, each once."""
        return [Mode(mode) for mode in dict.fromkeys(self.rows["mode"][since:].tolist())]

    def moved(self, since: int) -> float:
        """Largest distance of a leg from its length at a row, m."""
        return float(np.abs(self.true[since:] - self.true[since]).max())


@contextmanager
def bench(
    c: Configuration, *faults: PlantFault, seed: int = 0, plant_of: Configuration | None = None
) -> Iterator[Lockstep]:
    """Both ends of a configuration, to be stepped; `plant_of`: where drives and plant come from instead."""
    cycle = new_cycle(c)
    nodes, plant = build_nodes(plant_of or c, FaultPlan(faults, seed))
    try:
        yield build_lockstep(c, cycle, nodes)
    finally:
        plant.close()


def run(
    c: Configuration,
    *faults: PlantFault,
    stop_s: float | None = None,
    seed: int = 0,
    plant_of: Configuration | None = None,
    watch: Callable[[Lockstep, TickInput, Any], None] = lambda *_: None,
) -> Ran:
    """Run to the end, or to a stop; `watch` gets both ends, the input and the row of each tick."""
    rows: list[Any] = []
    true: list[Any] = []
    with bench(c, *faults, seed=seed, plant_of=plant_of) as lockstep, collector_paused():

        def observe(inp: TickInput, _opening: object, out: Any) -> None:
            rows.append(out.row)
            true.append(lockstep.nodes.snapshot().length)
            watch(lockstep, inp, out.row)

        ending = lockstep.run(stop_s, observe)
    return Ran(ending, np.array(rows, rows[0].dtype), np.array(true), lockstep.cycle)


def succeeded(c: Configuration, *faults: PlantFault, plant_of: Configuration | None = None) -> Ran:
    """Run to a success in which no force limit acts."""
    ran = run(c, *faults, plant_of=plant_of)
    assert ran.ending.success, ran.ending
    assert not any(ran.summary["limited_ticks"].values()), ran.summary["limited_ticks"]
    return ran


def until(lockstep: Lockstep, mode: Mode, course: Course | None = None) -> Any:
    """Step until the controller is in a mode, engaging on the way; return the row of its first tick."""
    operator: tuple[Operator, ...] = (Operator.RESET,)
    for _ in range(LAST):
        row = lockstep.step(course.commands(lockstep.tick + 1) if course else operator)[2].row
        assert course is None or course.ending(lockstep.tick) is None
        now = lockstep.cycle.mode
        if now is mode:
            return row
        operator = (Operator.ENGAGE,) if now is Mode.IDLE else ()
    raise AssertionError(f"{mode.name} not reached")
