"""Many ticks in one call give what one call for each gives."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest

from drivers.errors import PlantError
from drivers.tick_columns import ROW
from hil.app.compose import build_nodes
from hil.app.configuration.configuration import Configuration, load
from hil.app.sim.build import build_lockstep
from hil.app.sim.commands import CommandScript
from hil.app.sim.lockstep import Lockstep
from hil.loop.run_end import Ending
from hil.loop.tick_row import CAPACITY
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


def test_ticks_before_a_plant_fails_are_given_and_the_run_ends_in_the_tick_that_failed(monkeypatch):
    kept, failing = Kept(), 1000
    with bench(load("virtual")) as lockstep:
        nodes = lockstep.nodes
        known: Any = type(nodes).address

        def address(self: Any) -> int:
            """Let Python move the plant from some tick on, and fail."""
            return 0 if lockstep.tick + 1 >= failing - CAPACITY else int(known.fget(self))

        def advance(t_ns: int, received: Any) -> Any:
            if t_ns >= failing * lockstep.period_ns:
                raise PlantError("the model is gone")
            return type(nodes).advance(nodes, t_ns, received)

        monkeypatch.setattr(type(nodes), "address", property(address))
        monkeypatch.setattr(nodes, "advance", advance)
        ending = lockstep.run(2.0, None, take=kept.take)
    assert len(kept.rows) == failing == ending.ticks == lockstep.tick
    assert ending.reason.startswith("the model is gone")
    assert (lockstep.cycle.tick["tick"], lockstep.cycle.last["tick"]) == (failing - 1, failing - 2)


@pytest.mark.parametrize("place", ["_look_at_nodes", "row._turn_over"])
def test_a_run_that_is_interrupted_gives_no_tick_twice_and_none_that_was_not_made(place, monkeypatch):
    kept = Kept()
    with bench(load("virtual")) as lockstep:
        owner, name = (lockstep.row, "_turn_over") if "." in place else (lockstep, place)
        before = getattr(owner, name)

        def interrupted() -> None:
            before()
            if lockstep.tick > 600:
                raise KeyboardInterrupt

        monkeypatch.setattr(owner, name, interrupted)
        with pytest.raises(KeyboardInterrupt):
            lockstep.run(2.0, None, take=kept.take)
    ticks = [int(np.frombuffer(row, ROW)["tick"][0]) for row in kept.rows]
    assert ticks == list(range(len(ticks)))
    assert len(ticks) > 600
