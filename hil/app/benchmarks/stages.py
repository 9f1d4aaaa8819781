"""A Cycle that notes when each stage of its step begins: the same step, with eight looks at a clock.

Rule of the room: changes nothing that the cycle computes.
"""

from __future__ import annotations

import time
from array import array
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.protocol import Frame
from drivers.signals import Command
from hil.app.benchmarks.figures import Figure, Mark, spread
from hil.cycle import Cycle
from hil.parts import Parts
from hil.signals import Array, Effort, Estimate, Mode, TickInput, TickOutput

COMPUTE = Mark(40.0)
"""us, decode to encode and row."""
STAGES = ("decode", "estimate", "modes, reference", "law", "safety", "command", "row")
_COLUMNS = len(STAGES) + 2
BLOCK = 100
"""Ticks over which a neighbour of the core is looked for."""
_now = time.perf_counter_ns


class StagedCycle(Cycle):
    """Cycle with a stop-watch.

    Mutable state beside the cycle's: `stamps`, for each tick the beginning of each stage, the end of the
    last one (ns), and the mode. It costs about 1 us a tick.
    """

    def __init__(self, parts: Parts) -> None:
        self.stamps = array("q")
        super().__init__(parts)

    def step(self, inp: TickInput) -> TickOutput:
        """As Cycle.step."""
        self.stamps.append(_now())
        out = super().step(inp)
        self.stamps.append(_now())
        self.stamps.append(self.mode)
        return out

    def _estimate(self, *values: Any) -> Estimate:
        self.stamps.append(_now())
        estimate = super()._estimate(*values)
        self.stamps.append(_now())
        return estimate

    def _effort(self, *values: Any) -> tuple[Effort, Array]:
        self.stamps.append(_now())
        effort = super()._effort(*values)
        self.stamps.append(_now())
        return effort

    def _command(self, *values: Any) -> Command:
        self.stamps.append(_now())
        return super()._command(*values)

    def _setup(self, tick: int) -> tuple[Frame, ...]:
        frames = super()._setup(tick)
        self.stamps.append(_now())  # the row comes next
        return frames


def stage_figures(cycle: StagedCycle, mode: Mode = Mode.TRACKING) -> list[Figure]:
    """Return median and p99 of the whole step and of each stage over the ticks in `mode`."""
    stamps = _stamps(cycle, mode)
    whole = Figure("tick compute", spread(stamps[:, -1] - stamps[:, 0]), "us", COMPUTE)
    stages = np.diff(stamps, axis=1).T
    return [
        whole,
        *(Figure(f"  {name}", spread(ns), "us") for name, ns in zip(STAGES, stages, strict=True)),
    ]


def quietest_figure(cycle: StagedCycle, mode: Mode = Mode.TRACKING) -> Figure:
    """Return the step in the block of ticks with the smallest median: without a neighbour on the core."""
    stamps = _stamps(cycle, mode)
    whole = stamps[:, -1] - stamps[:, 0]
    blocks = whole[: len(whole) // BLOCK * BLOCK].reshape(-1, BLOCK)
    medians = np.median(blocks, axis=1)
    if not medians.size:
        return Figure("quietest block", note=f"fewer than {BLOCK} ticks")
    within = int(np.count_nonzero(medians <= COMPUTE.limit * 1e3))
    note = f"of {len(medians)} blocks of {BLOCK} ticks; the median of {within} is within the mark"
    return Figure("quietest block", spread(blocks[medians.argmin()]), "us", note=note)


def _stamps(cycle: StagedCycle, mode: Mode) -> NDArray[np.int64]:
    """Return the instants (ticks in `mode`, stages + 1), ns."""
    table = np.array(cycle.stamps, np.int64)
    table = table[: table.size // _COLUMNS * _COLUMNS].reshape(-1, _COLUMNS)
    return table[table[:, -1] == mode, :-1]
