"""Cycles that look at a clock: around the whole step, or as each of its stages begins."""

import time
from array import array

import numpy as np

from drivers.arrays import Ints
from drivers.protocol import Frame
from drivers.signals import Command, Mode
from drivers.tick_columns import Record
from hil.loop.cycle import Cycle
from hil.loop.parts import Parts
from hil.loop.sight import Sight
from hil.signals import TickInput, TickOutput
from tools.benchmarks.figures import Figure, Mark, spread

COMPUTE = Mark(40.0)
"""us, decode to encode and row."""
STAGES = ("decode", "estimate", "modes, reference", "law", "safety", "command", "row")
BLOCK = 100
"""Ticks over which a neighbour of the core is looked for."""
_now = time.perf_counter_ns


class TimedCycle(Cycle):
    """Cycle with a stop-watch around its step, which may sleep before it (outside the stop-watch).

    Mutable state beside the cycle's: `stamps`, for each tick the step's beginning and end (ns), and the mode.
    """

    def __init__(self, parts: Parts, sleep_s: float | None = None) -> None:
        self.stamps = array("q")
        self._sleep_s = sleep_s
        super().__init__(parts)

    def step(self, inp: TickInput) -> TickOutput:
        """As Cycle.step."""
        if self._sleep_s is not None:
            time.sleep(self._sleep_s)
        begun = _now()
        out = super().step(inp)
        ended = _now()
        self.stamps.extend((begun, ended, self.mode))
        return out

    def compute_ns(self, mode: Mode = Mode.TRACKING) -> Ints:
        """Return what each tick in `mode` took."""
        table = np.array(self.stamps, np.int64).reshape(-1, 3)
        taken: Ints = (table[:, 1] - table[:, 0])[table[:, 2] == mode]
        return taken


class StagedSight(Sight):
    """Sight with a stop-watch. Mutable state beside its own: the stamps of the cycle."""

    def __init__(self, parts: Parts, stamps: "array[int]") -> None:
        self.stamps = stamps
        super().__init__(parts)

    def estimate(self, tick: Record, last: Record, latched_ns: int) -> None:
        """As Sight.estimate."""
        self.stamps.append(_now())
        super().estimate(tick, last, latched_ns)
        self.stamps.append(_now())


class StagedCycle(Cycle):
    """Cycle with a stop-watch at each stage, which makes the whole step some 5 us longer.

    Mutable state beside the cycle's: `stamps`, for each tick the beginning of each stage, the end of the
    last one (ns), and the mode.
    """

    def __init__(self, parts: Parts) -> None:
        self.stamps = array("q")
        super().__init__(parts)
        self.sight = StagedSight(parts, self.stamps)

    def step(self, inp: TickInput) -> TickOutput:
        """As Cycle.step."""
        self.stamps.append(_now())
        out = super().step(inp)
        self.stamps.append(_now())
        self.stamps.append(self.mode)
        return out

    def _effort(self, tick: Record) -> None:
        self.stamps.append(_now())
        super()._effort(tick)
        self.stamps.append(_now())

    def _command(self, tick: Record, *, stops: bool) -> Command:
        self.stamps.append(_now())
        return super()._command(tick, stops=stops)

    def _set_up(self, tick: Record) -> tuple[Frame, ...]:
        frames = super()._set_up(tick)
        self.stamps.append(_now())  # the row comes next
        return frames


def compute_figure(ns: Ints) -> Figure:
    """Return median and p99 of the step, with its mark."""
    return Figure("tick compute", spread(ns), "us", COMPUTE)


def quietest_figure(ns: Ints) -> Figure:
    """Return the step in the block of ticks with the smallest median: without a neighbour on the core."""
    blocks = ns[: len(ns) // BLOCK * BLOCK].reshape(-1, BLOCK)
    medians = np.median(blocks, axis=1)
    if not medians.size:
        return Figure("  quietest block", note=f"fewer than {BLOCK} ticks")
    within = int(np.count_nonzero(medians <= COMPUTE.limit * 1e3))
    note = f"of {len(medians)} blocks of {BLOCK} ticks; the median of {within} is within the mark"
    return Figure("  quietest block", spread(blocks[medians.argmin()]), "us", note=note)


def stage_figures(cycle: StagedCycle, mode: Mode = Mode.TRACKING) -> list[Figure]:
    """Return median and p99 of each stage over the ticks in `mode`."""
    table = np.array(cycle.stamps, np.int64).reshape(-1, len(STAGES) + 2)
    stages = np.diff(table[table[:, -1] == mode, :-1], axis=1).T
    return [Figure(f"  {name}", spread(ns), "us") for name, ns in zip(STAGES, stages, strict=True)]
