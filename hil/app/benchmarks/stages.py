"""A Cycle that notes when each stage of its step begins: the same step, with eight looks at a clock.

Rule of the room: changes nothing that the cycle computes.
"""

from __future__ import annotations

import time
from array import array
from typing import Any

import numpy as np

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
    table = np.array(cycle.stamps, np.int64)
    table = table[: table.size // _COLUMNS * _COLUMNS].reshape(-1, _COLUMNS)
    stamps = table[table[:, -1] == mode, :-1]
    whole = Figure("tick compute", spread(stamps[:, -1] - stamps[:, 0]), "us", COMPUTE)
    stages = np.diff(stamps, axis=1).T
    return [
        whole,
        *(Figure(f"  {name}", spread(ns), "us") for name, ns in zip(STAGES, stages, strict=True)),
    ]
