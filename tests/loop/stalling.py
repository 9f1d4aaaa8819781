"""A lockstep bench whose controller stalls: asleep, before SYNC, between two buses, before its command."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from drivers.arrays import Rows
from drivers.can.bus_time import BitTiming
from hil.app.configuration.configuration import Configuration
from hil.loop.cycle import Cycle
from hil.signals import Operator, Order, SetPoint, TickInput, TickOutput
from plant_fmu.drives.nodes import Nodes
from tests.loop.stepwise import Stepwise

PLACES = ("asleep", "before SYNC", "before the command", "between the SYNCs of two buses")


@dataclass
class Stalling(Stepwise):
    """A controller whose machine takes the processor away now and then, and wakes it late.

    It stalls in its sleep, between the clock and SYNC, and between the feedbacks and the command, each every
    `every_s` on average and for up to `longest_ns`. With several buses it also stalls between the sends of
    the first bus and the others. Missed periods are skipped.

    Mutable state: `Lockstep`'s, the lateness of the next tick, and the periods skipped before it.
    """

    generator: np.random.Generator = field(default_factory=np.random.default_rng)
    every_s: float = 0.5
    longest_ns: int = 0
    timetable: dict[int, tuple[int, int]] = field(default_factory=dict)
    """Place and length, ns, of the stall in a tick, in addition to random ones."""
    jitter_ns: int = 30_000
    stalls: int = 0
    _skipped: int = 0
    _lateness_ns: int = 0

    def step(
        self,
        operator: tuple[Operator, ...] = (),
        setpoints: tuple[SetPoint, ...] = (),
        orders: tuple[Order, ...] = (),
    ) -> tuple[TickInput, Rows, TickOutput]:
        """Advance both ends by one tick."""
        self.tick = tick = self.tick + 1
        t_ns, next_ns = tick * self.period_ns, (tick + 1) * self.period_ns
        skipped, lateness_ns = self._skipped, self._lateness_ns
        asleep_ns, unseen_ns, held_ns, apart_ns = self._stall()
        opening, w = self.cycle.begin(tick), self.wires.record
        sent_ns = max(t_ns + lateness_ns + unseen_ns, self.nodes.now_ns)
        given = opening.copy()
        given["t_ns"] = np.where(given["bus"] > 0, sent_ns + apart_ns, sent_ns)
        window_ns, self.window_ns = self.window_ns, self.window_ns - (sent_ns - t_ns)
        heard = self.exchange(sent_ns, given)
        self.window_ns = window_ns
        behind_ns = sent_ns - t_ns - lateness_ns
        inp = TickInput(
            tick,
            t_ns,
            lateness_ns,
            skipped,
            sync_skew_ns=int(w["skew_ns"]),
            frames=heard,
            latch_ns=tuple([each + behind_ns for each in w["latch_ns"].tolist()]),
            operator=operator,
            setpoints=setpoints,
            orders=orders,
        )
        out = self.cycle.step(inp)
        done_ns = max(int(w["step_ns"]), sent_ns + apart_ns) + self.compute_ns + held_ns
        self.send(out.frames, done_ns, next_ns - 1)
        awake_ns = max(done_ns, next_ns + asleep_ns)
        self._skipped = (awake_ns - next_ns) // self.period_ns
        self.tick += self._skipped
        self._lateness_ns = awake_ns - next_ns - self._skipped * self.period_ns
        return inp, opening, out

    def _stall(self) -> list[int]:
        """Delay of this tick at each of the PLACES, ns."""
        stall = [int(self.generator.integers(self.jitter_ns)), 0, 0, 0]
        place, known_ns = self.timetable.get(self.tick, (0, 0))
        stall[place] += known_ns
        if self.longest_ns and self.generator.random() < 1e-9 * self.period_ns / self.every_s:
            self.stalls += 1
            places = len(PLACES) - (len(self.timings) < 2)
            stall[self.generator.integers(places)] += int(self.generator.integers(self.longest_ns))
        return stall


def build_stalling(c: Configuration, nodes: Nodes, cycle: Cycle, **stalls: Any) -> Stalling:
    """A stalling bench, with one wire per bus of the configuration."""
    timings = [None if c.bus.layout == "ideal" else BitTiming.of(each) for each in c.bus.buses]
    return Stalling(cycle, nodes, timings, c.loop.window_s(c.loop.rate_Hz), **stalls)
