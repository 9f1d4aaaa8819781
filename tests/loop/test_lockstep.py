"""The whole loop over the virtual bus in simulated time."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest

from drivers.can.arbitration import priority
from drivers.can.bus_time import BitTiming, frame_time_ns
from drivers.frame_array import received_frames, sent_frames
from drivers.protocol import Frame
from drivers.signals import Mode
from hil.app.compose import build_nodes
from hil.app.configuration.configuration import Configuration, load
from hil.app.sim.build import build_lockstep
from hil.app.sim.command import simulate
from hil.app.sim.commands import CommandScript
from hil.app.sim.lockstep import Lockstep
from hil.loop.run_end import Ending
from hil.record.log import Log
from hil.signals import Operator
from tests.drivers.arbitration_queue import arbitrate
from tests.golden.cases import CASES
from tests.golden.runner import configured
from tests.loop.bench import changed, new_cycle
from tests.loop.operator_runs import modes


@pytest.fixture(scope="module")
def virtual():
    return load("virtual")


ONE_PASS_S = 3.3
"""The book's path begins at 1.25 s and repeats itself after 2 s."""


@pytest.fixture(scope="module")
def recorded(virtual, tmp_path_factory):
    path = tmp_path_factory.mktemp("virtual") / "run.mcap"
    return simulate(virtual, log=path, duration_s=ONE_PASS_S), Log.open(path)


def test_simulated_run_over_the_bus_starts_without_a_bump_and_tracks_within_half_a_mm(recorded):
    summary, log = recorded
    rows = log.rows()
    assert summary["success"], summary
    assert modes(rows) == [mode.name for mode in Mode if mode not in {Mode.HELD, Mode.FAULT}]
    assert [summary[key] for key in ("stale_ticks", "rejected_frames", "dropped_ticks")] == [0, 0, 0]
    assert (rows["frames_received"][5:] >= 6).all()
    assert 0.01 < summary["tracking"]["peak_leg_error_mm"] < 0.5
    entry = rows[(rows["mode"] >= Mode.RELEASING) & (rows["mode"] <= Mode.APPROACH)]
    assert np.abs(entry["q"] - rows["q"][rows["mode"] == Mode.LOADING][0]).max() < 20e-6


def test_two_simulations_of_one_configuration_give_equal_bytes(virtual, recorded, tmp_path):
    again = tmp_path / "again.mcap"
    simulate(virtual, log=again, duration_s=ONE_PASS_S, check_replay=False)
    first, second = recorded[1], Log.open(again)
    assert first.rows().tobytes() == second.rows().tobytes()
    for a, b in zip(first.ticks(), second.ticks(), strict=True):
        assert (a.received, a.sent, a.operator) == (b.received, b.sent, b.operator)


@pytest.mark.parametrize("duration_s", [0.002, 0.05, 0.35])
def test_simulation_that_is_stopped_before_the_drives_are_ready_ends(virtual, tmp_path, duration_s):
    summary = simulate(virtual, log=tmp_path / "short.mcap", duration_s=duration_s)
    assert summary["final_mode"] == "PARKED"
    assert summary["duration_s"] < 1.5


@pytest.mark.parametrize("layout", ["fd", "classic"])
def test_simulated_frames_of_a_period_end_at_the_times_of_bus_arbitration(virtual, layout, monkeypatch):
    """SYNC, six answers and the commands, in ticks without a status frame; identifiers not in the order of
    legs.
    """
    c = changed(
        virtual,
        drives={"node_ids": [3, 1, 6, 2, 5, 4], "watchdog_ms": 25},
        bus={"layout": layout},
        loop={"rate_Hz": 400},
    )
    cycle, (nodes, plant), timing = new_cycle(c), build_nodes(c), BitTiming.of(c.bus)
    lockstep = Lockstep(cycle, nodes, (timing,), c.loop.window_s(400.0))
    live = nodes.advance
    answers: list[tuple[int, Frame]] = []
    got: set[tuple[int, Frame]] = set()
    expected: set[tuple[int, Frame]] = set()

    def advance(t_ns, received):
        got.update(received_frames(received))
        sent = live(t_ns, received)
        answers[:] = received_frames(sent)
        return sent

    monkeypatch.setattr(type(nodes), "address", 0)  # they live by `advance`
    monkeypatch.setattr(nodes, "advance", advance)
    operator: tuple[Operator, ...] = ()
    for _ in range(300):
        inp, opening, out = lockstep.step(operator)
        operator = (Operator.ENGAGE,) if cycle.mode is Mode.IDLE else ()
        heard = received_frames(inp.frames)
        got.update(heard)
        if len(answers) > 6:
            continue
        last_ns = max(t_ns for t_ns, frame in heard if frame.id in cycle.parts.protocol.traits.feedback_ids)
        queued = [(inp.t_ns, frame) for frame in sent_frames(opening)] + answers
        queued += [(last_ns + 60_000, frame) for frame in sent_frames(out.frames)]
        entries = [
            (t_ns, priority(frame.id, frame.flags), n, frame_time_ns(len(frame.data), frame.flags, timing))
            for n, (t_ns, frame) in enumerate(queued)
        ]
        ends, free_ns = arbitrate(entries, inp.t_ns, inp.t_ns + lockstep.period_ns)
        assert len(ends) == len(queued)
        assert free_ns < inp.t_ns + lockstep.period_ns
        expected.update((end_ns, queued[n][1]) for n, end_ns in ends)
    lockstep.step()
    plant.close()
    assert cycle.mode > Mode.LOADING
    assert len(expected) > 200 * 8
    assert expected <= got


# -- many ticks in one call ----------------------------------------------------------------------------------


NAMES = (
    "shipped virtual",
    "shipped two buses",
    "shipped virtual-cia402",
    "reference live, then hold, start and park",
    "law inverse_dynamics with the wrench observer",
)


class Kept:
    """All ticks of a run: rows, frames, and the number of calls. State: these."""

    def __init__(self) -> None:
        self.rows: list[bytes] = []
        self.frames: list[bytes] = []
        self.calls = 0

    def observe(self, inp: Any, opening: Any, out: Any) -> None:
        """Add one tick."""
        self.calls += 1
        sent = np.concatenate((opening, out.frames))
        sent["t_ns"] = inp.t_ns
        self.rows.append(out.row.tobytes())
        self.frames += [each.tobytes() for each in (*inp.frames, *sent)]

    def take(self, ticks: Any, new: slice, _given: Any) -> None:
        """Add many ticks."""
        self.calls += 1
        rows, frames, _ends = ticks.recorded(new)
        self.rows += [row.tobytes() for row in rows]
        self.frames += [each.tobytes() for each in frames]


@contextmanager
def attended(c: Configuration) -> Iterator[Lockstep]:
    nodes, plant = build_nodes(c)
    try:
        yield build_lockstep(c, new_cycle(c), nodes, attended=True)
    finally:
        plant.close()


def kept_of(name: str, *, at_once: bool) -> tuple[Kept, Ending]:
    case, kept = CASES[name], Kept()
    c = configured(case)
    script = CommandScript(case.commands, c.loop.rate_Hz)
    with attended(c) as lockstep:
        ending = lockstep.run(
            min(case.duration_s or 2.0, 2.0), None if at_once else kept.observe, commands=script, take=kept.take,
            silent=script.silent, armed=not script.arms, over=lambda: script.over,
        )  # fmt: skip
    return kept, ending


@pytest.mark.parametrize("name", NAMES)
def test_many_simulated_periods_in_one_call_give_the_same_rows_as_single_calls(name):
    (alone, one), (together, many) = kept_of(name, at_once=False), kept_of(name, at_once=True)
    assert together.rows == alone.rows
    assert together.frames == alone.frames
    assert (many.mode, many.ticks, many.reason) == (one.mode, one.ticks, one.reason)
    assert together.calls < alone.calls // 4
