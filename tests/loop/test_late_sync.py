"""A late SYNC disturbs no rate, causes no doubt and replays exactly: its own send time counts, on each bus."""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

import numpy as np
import pytest

from drivers.arrays import Array
from drivers.frame_array import received_frames, sent_frames
from hil.app.compose import build_nodes
from hil.app.configuration.configuration import Configuration
from hil.loop.replay import replay
from hil.record.log import Tick
from plant_fmu.faults.plan import FaultPlan
from tests.broad import broad
from tests.loop.bench import changed, new_cycle
from tests.loop.stalling import PLACES, build_stalling

BUSES = [{"channel": "c0", "legs": [0, 2, 4]}, {"channel": "c1", "legs": [1, 3, 5]}]
STALLS_NS = (1_480_000, 300_000, 2_300_000, 4_100_000)
STRAYING = 8
"""Ticks after a missed leg within which an answer may belong to the SYNC before."""
MOVES = 620, 12, 764
"""First tick with a stall, ticks between stalls, and last tick: the legs move at up to 1 m/s there."""


class Ran(NamedTuple):
    c: Configuration
    ticks: list[Tick]
    rows: Any
    true: Array
    """(n, 6) m/s, the plant's true rates when the drives were last read."""


def configuration(buses: bool) -> Configuration:
    return changed("virtual-cia402", bus={"channel": None, "channels": BUSES} if buses else {})


@cache
def run(place: str, buses: bool) -> Ran:
    """Run into the motion with stalls of all lengths at one place."""
    c, (first, step, last) = configuration(buses), MOVES
    where = PLACES.index(place)
    table = {tick: (where, STALLS_NS[n % len(STALLS_NS)]) for n, tick in enumerate(range(first, last, step))}
    nodes, plant = build_nodes(c, FaultPlan([]))
    bench = build_stalling(c, nodes, new_cycle(c), timetable=table)
    ticks: list[Tick] = []
    true: list[Array] = []

    def observe(inp: Any, opening: Any, out: Any) -> None:
        sent = sent_frames(opening) + sent_frames(out.frames)
        ticks.append(Tick(out.row.copy(), received_frames(inp.frames), sent, tuple(map(int, inp.operator))))
        true.append(nodes.snapshot().rate.copy())

    try:
        bench.run((last + 1) / c.loop.rate_Hz, observe)
    finally:
        plant.close()
    kept = [n for n, tick in enumerate(ticks) if tick.row["tick"] <= last]
    rows = np.array([ticks[n].row for n in kept])
    return Ran(c, [ticks[n] for n in kept], rows, np.array([true[n] for n in kept]))


CASES = [
    *[("before SYNC", False), ("between the SYNCs of two buses", True)],
    *[("asleep", False), ("before the command", False), ("before SYNC", True)],
]


@pytest.mark.parametrize(("place", "buses"), broad(CASES, quick=2))
def test_measured_leg_rates_stay_correct_if_the_sync_frame_is_late(place, buses):
    """By the clock at wake-up, 1.06 m/s would read 2.01 m/s."""
    ran = run(place, buses)
    moving, heard = ran.rows["tick"] >= MOVES[0], ran.rows["age"] == 0
    missed = ~heard.all(axis=1)
    strays = np.array([missed[max(n - STRAYING, 0) : n].any() for n in range(len(missed))])
    error = np.abs(ran.rows["dq"] - ran.true).max(axis=1, where=heard, initial=0.0)
    assert np.abs(ran.true[moving]).max() > 0.8
    assert heard[moving].mean() > 0.9
    assert error[moving & ~strays].max() < 0.03
    assert error[moving & strays].max(initial=0.0) < 0.2, "an answer may belong to the SYNC before"
    assert not ran.rows["faults"].any()
    assert not ran.rows["legs_doubted"].any()


@pytest.mark.parametrize(("place", "buses"), CASES[:2])
def test_run_with_late_sync_frames_replays_to_the_bit(place, buses):
    ran = run(place, buses)

    class Kept:
        def ticks(self):
            return iter(ran.ticks)

    compared = replay(Kept(), new_cycle(ran.c))
    assert compared.exact, compared.first
    delays = ran.rows["latch_ns"]
    assert delays.max() > STALLS_NS[0]
    assert (np.ptp(delays, axis=1).max() > STALLS_NS[0]) == buses, "each bus has its own delay"
