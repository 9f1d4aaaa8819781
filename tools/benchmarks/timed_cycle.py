"""A cycle with a stop-watch around its step, and the figures of that."""

import time
from array import array
from collections.abc import Iterable

import numpy as np

from drivers.arrays import Ints
from drivers.frame_array import joined, sent_frames
from drivers.signals import Mode
from hil.loop.cycle import Cycle
from hil.loop.parts import Parts
from hil.loop.replay import recorded_input
from hil.record.log import Tick
from hil.signals import TickInput, TickOutput
from tools.benchmarks.figures import Figure, Mark, spread

COMPUTE = Mark(40.0)
"""us, decode to encode and row."""
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


def feed(entries: Iterable[Tick], cycle: Cycle) -> int:
    """Give a cycle the recorded inputs of ticks, one by one; return how many came out differently."""
    different = 0
    for entry in entries:
        inp = recorded_input(entry)
        opening = cycle.begin(inp.tick)
        out = cycle.step(inp)
        same = sent_frames(joined((opening, out.frames))) == entry.sent
        different += not (same and out.row.tobytes() == entry.row.tobytes())
    return different


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
