"""Many ticks in one call give what one call for each gives."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest

from hil.app.compose import build_nodes
from hil.app.configuration.configuration import Configuration
from hil.app.sim.build import build_lockstep
from hil.app.sim.commands import CommandScript
from hil.app.sim.lockstep import Lockstep
from hil.loop.run_end import Ending
from tests.golden.cases import CASES
from tests.golden.runner import configured, new_cycle

NAMES = (
    "shipped virtual",
    "shipped two buses",
    "shipped virtual-cia402",
    "reference live, then hold, start and park",
    "law inverse_dynamics with the wrench observer",
)


class Kept:
    """All ticks of a run: rows, frames, and how many calls it took. State: these."""

    def __init__(self) -> None:
        self.rows: list[bytes] = []
        self.frames: list[bytes] = []
        self.calls = 0

    def observe(self, inp: Any, opening: Any, out: Any) -> None:
        """Take one tick."""
        self.calls += 1
        sent = np.concatenate((opening, out.frames))
        sent["t_ns"] = inp.t_ns
        self.rows.append(out.row.tobytes())
        self.frames += [each.tobytes() for each in (*inp.frames, *sent)]

    def take(self, ticks: Any, new: slice, _given: Any) -> None:
        """Take many."""
        self.calls += 1
        rows, frames, _ends = ticks.recorded(new)
        self.rows += [row.tobytes() for row in rows]
        self.frames += [each.tobytes() for each in frames]


@contextmanager
def bench(c: Configuration) -> Iterator[Lockstep]:
    nodes, plant = build_nodes(c)
    try:
        yield build_lockstep(c, new_cycle(c), nodes, attended=True)
    finally:
        plant.close()


def run(name: str, *, at_once: bool) -> tuple[Kept, Ending]:
    case, kept = CASES[name], Kept()
    c = configured(case)
    script = CommandScript(case.commands, c.loop.rate_Hz)
    with bench(c) as lockstep:
        ending = lockstep.run(
            min(case.duration_s or 2.0, 2.0), None if at_once else kept.observe, commands=script, take=kept.take,
            silent=script.silent, armed=not script.arms, over=lambda: script.over,
        )  # fmt: skip
    return kept, ending


@pytest.mark.parametrize("name", NAMES)
def test_many_ticks_in_one_call_are_those_of_one_call_each(name):
    (alone, one), (together, many) = run(name, at_once=False), run(name, at_once=True)
    assert together.rows == alone.rows
    assert together.frames == alone.frames
    assert (many.mode, many.ticks, many.reason) == (one.mode, one.ticks, one.reason)
    assert together.calls < alone.calls // 4
