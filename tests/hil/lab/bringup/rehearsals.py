"""Rehearsals in one process that record the forces, brakes and travel of the plant."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cache

import numpy as np

from drivers.arrays import Array
from drivers.protocol import Frame
from hil.app.compose import build_protocol
from hil.app.configuration.configuration import Configuration, load
from hil.lab.bringup.context import Context, Request, Step
from hil.lab.bringup.drives import Drives, Heard
from hil.lab.bringup.machine import bringup_rate, build_machine, known_poses
from hil.lab.bringup.procedure import STEPS, Outcome, bring_up
from hil.lab.bringup.rehearsal import BenchHands, BenchLine, build_bench, mistake_of
from plant_fmu.plant import Plant
from plant_fmu.rehearsal.bench import RehearsalBench
from plant_fmu.rehearsal.wiring import Wiring, wired
from tests.hil.lab.bringup.families import FAMILIES, family

configuration = cache(load)


@dataclass
class Watched:
    """Forces on the legs, open brakes and travel during a rehearsal."""

    most_open: int = 0
    """Largest number of working brakes open at once."""
    most_force_N: float = 0.0
    most_travel_m: float = 0.0
    """Travel of a leg during one opening of a brake, without a hand on it."""
    opened_while_hung: int = 0
    """Steps of the plant with a brake open while the platform hung on the legs."""
    _origin: Array = field(default_factory=lambda: np.zeros(6))
    _open: bool = False

    def look(self, bench: RehearsalBench, force: Array, held: Array) -> None:
        w = bench.wiring
        works = np.array([stuck is None for stuck in w.stuck]) & ~np.array(w.brake_inverted)
        free, legs = int(((held == 0.0) & works).sum()), np.array([bench.length(leg) for leg in range(6)])
        self.most_open = max(self.most_open, free)
        self.opened_while_hung += bool(free) and bench.hung
        if free:
            self.most_force_N = max(self.most_force_N, float(np.abs(force).max()))
            if not self._open or bench._legs.legs["hand"].any():
                self._origin = legs
            self.most_travel_m = max(self.most_travel_m, float(np.abs(legs - self._origin).max()))
        self._open = free > 0


class Seen(Plant):
    """A plant that passes its forces and brakes to a function after each step."""

    def __init__(self, plant: Plant, look: Callable[[Array, Array], None]) -> None:
        self._plant, self._look, self.internal_step_s = plant, look, plant.internal_step_s

    def reset(self) -> tuple[Array, Array]:
        return self._plant.reset()

    def step(self, force: Array, brake: Array, wrench: Array, dt_s: float) -> tuple[Array, Array]:
        found = self._plant.step(force, brake, wrench, dt_s)
        self._look(force, brake)
        return found


class Hands(BenchHands):
    """The bench's hands; they record all requests and may interrupt at one of them."""

    def __init__(self, bench: RehearsalBench, c: Configuration, stop_at: int = -1) -> None:
        super().__init__(bench, known_poses(c))
        self.requests: list[Request] = []
        self._stop_at = stop_at
        self.agrees = True

    def consent(self, *_: str) -> bool:
        return self.agrees

    def ask(self, request: Request) -> None:
        self.requests.append(request)
        if len(self.requests) == self._stop_at:
            raise KeyboardInterrupt
        super().ask(request)


def _configured(given: str | Configuration) -> Configuration:
    if isinstance(given, Configuration):
        return given
    return family(given) if given in FAMILIES else configuration(given)


class Rehearsal:
    """One bring-up of a bench with a wiring; a text is the name of a mistake, empty a good machine."""

    def __init__(
        self,
        name: str | Configuration,
        wiring: Wiring | str = "",
        *,
        seed: int = 1,
        stop_at: int = -1,
        facts=None,
        faults=None,
        watched: bool = True,
    ) -> None:
        self.c = c = _configured(name)
        if isinstance(wiring, str):
            wiring = wired(mistake_of(wiring)) if wiring else Wiring()
        self.bench = bench = build_bench(c, wiring, seed, faults)
        self.watched = Watched()
        held = np.ones(6)
        if watched:
            bench.cables.exchange(Seen(bench._legs, lambda _, brake: np.copyto(held, brake)))
            bench.nodes._plant = Seen(bench.cables, lambda force, _: self.watched.look(bench, force, held))
        self.hands = Hands(bench, c, stop_at)
        protocol = build_protocol(c)
        self.machine = build_machine(c, protocol)
        self.drives = Drives(protocol, BenchLine(bench.nodes, bringup_rate(c)), self.machine.watchdog_s)
        self.context = Context(self.machine, self.drives, self.hands, {} if facts is None else facts)

    def hears(self, change: Callable[[Heard, Sequence[Frame]], Heard]) -> None:
        """Change the frames received in each tick; `change` gets them and the opening frames of the tick."""
        exchange = self.drives.line.exchange
        self.drives.line.exchange = lambda opening: change(exchange(opening), opening)  # type: ignore[method-assign]

    def run(self, steps: tuple[Step, ...] = STEPS) -> Outcome:
        return bring_up(self.context, steps)


def named(outcome: Outcome) -> set[tuple[str, tuple[int, ...]]]:
    """Names and legs of the findings."""
    return {(finding.name, tuple(sorted(finding.legs))) for finding in outcome.findings}
