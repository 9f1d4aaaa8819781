"""How `hil plant` ends and what it then says, in summary and log: of a plant that has failed, too."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable
from math import inf
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from drivers.arrays import Array, Rows
from drivers.config import DriveSettings
from drivers.errors import PlantError
from drivers.frame_array import received_array
from drivers.protocol import Frame, Received
from hil.app import plant
from hil.app.compose import build_protocol
from hil.app.configuration.configuration import load
from hil.loop.clock import RealTime
from plant_fmu.config import DriveEmulation
from plant_fmu.drives.nodes import Nodes
from plant_fmu.plant import Truth
from tests.drivers.legs_frames import opening

MS = 1_000_000
DIED = "its process died of SIGKILL"


class Legs:
    """Six legs of 1.5 m. State: time, whether it lives.

    rates : m/s, at a time; dies_s : from then on it answers nothing; resets : how often it can be reset.
    """

    internal_step_s = 1e-3

    def __init__(
        self,
        rates: Callable[[float], list[float]] = lambda _: [0.0] * 6,
        *,
        dies_s: float = inf,
        resets: int = 2,
    ) -> None:
        self._rates, self._dies_s, self._resets = rates, dies_s, resets
        self._t_s = 0.0
        self._dead = False

    def _answer(self) -> tuple[Array, Array]:
        if self._dead:
            raise PlantError(DIED)
        return np.full(6, 1.5), np.array(self._rates(self._t_s))

    def reset(self) -> tuple[Array, Array]:
        self._resets -= 1
        self._dead = self._resets < 0
        return self._answer()

    def step(self, _force: Array, _brake: Array, _wrench: Array, dt_s: float) -> tuple[Array, Array]:
        self._t_s += dt_s
        self._dead = self._dead or self._t_s > self._dies_s
        return self._answer()

    def truth(self) -> Truth:
        self._answer()
        return Truth(np.zeros(3), np.eye(3), np.zeros(6), np.zeros(6))

    def applied_force(self) -> None:
        """It knows of no lag."""

    def close(self) -> None:
        """Nothing to free."""


class Asked:
    """A bus on which a SYNC comes every `period_ns`. State: its time and the number of the SYNC."""

    def __init__(self, sync: Callable[[int], Frame], period_ns: int) -> None:
        self.t_ns = 0
        self.clock = SimpleNamespace(now=lambda: self.t_ns, leave=lambda: None)
        self._sync, self._period_ns = sync, period_ns

    def drain_now(self) -> Rows:
        self.t_ns += self._period_ns
        return received_array([Received(self.t_ns, self._sync(self.t_ns // self._period_ns))])

    def send(self, _frames: Rows) -> None:
        """Nobody hears the answers."""


class Kept:
    """What a recording was given."""

    def __init__(self) -> None:
        self.events: list[tuple[str, str]] = []
        self.closed: dict[str, Any] = {}

    def tick_of_items(self, *_: Any) -> None:
        """No test looks at rows."""

    def event(self, _t_ns: int, level: str, text: str) -> None:
        self.events.append((level, text))

    def close(self, ending: dict[str, Any]) -> Any:
        self.closed = ending
        return SimpleNamespace(path="a.mcap", dropped=0, lost=0, complete=True, gave_up=False, error="")


@pytest.fixture
def serve(monkeypatch):
    """Let the drives be asked every `period_ns` for 50 ms, or until a plant without a daemon ends."""

    def run(legs: Legs, *, period_ns: int = MS, orphan: bool = False) -> tuple[dict[str, Any], Kept, float]:
        c = load("virtual")
        protocol = build_protocol(c)
        bus, log = Asked(lambda tick: opening(protocol, tick)[0], period_ns), Kept()
        start = SimpleNamespace(start=lambda *_, **__: contextlib.nullcontext(log))
        monkeypatch.setattr(plant, "_open_bus", lambda *_: contextlib.nullcontext(bus))
        monkeypatch.setattr(plant, "real_time", lambda *_: contextlib.nullcontext(RealTime()))
        monkeypatch.setattr(plant, "log_path", lambda *_: None)
        monkeypatch.setattr(plant, "Recording", start)
        nodes = Nodes(legs, protocol, DriveEmulation(), DriveSettings())
        supervisor, held = os.pipe()
        os.close(held)
        ends: dict[str, Any] = {"supervisor": supervisor} if orphan else {"duration_s": 0.05}
        try:
            summary = plant.run_plant(c, **ends, bench=plant.Bench(nodes, legs, lambda: None))
        finally:
            os.close(supervisor)
        return summary, log, 1e-9 * bus.t_ns

    return run


@pytest.mark.parametrize(
    "legs", [lambda: Legs(dies_s=0.0115), lambda: Legs(resets=1)], ids=["later", "at once"]
)
def test_a_dead_plant_is_a_failure_in_summary_and_log(serve, legs):
    summary, log, _ = serve(legs())
    assert (summary["success"], summary["trouble"]) == (False, DIED)
    assert summary["final_states"] == ["BOOT"] * 6
    assert ("error", DIED) in log.events
    assert log.closed["trouble"] == DIED


@pytest.mark.parametrize("rate_m_s", [0.3, -0.3])
@pytest.mark.parametrize(("rests_s", "end_s"), [(inf, plant.ORPHAN_S), (1.0, 1.2), (0.0, 0.2)])
def test_an_orphan_ends_once_its_legs_rest_and_at_a_limit_anyway(serve, rate_m_s, rests_s, end_s):
    """The daemon is gone from the beginning. All legs but one move."""
    moving, still = [rate_m_s] * 5 + [0.0], [0.0] * 6
    legs = Legs(lambda t_s: moving if t_s < rests_s else still)
    summary, _, ended_s = serve(legs, period_ns=10 * MS, orphan=True)
    assert summary["ending"] == "orphaned"
    assert ended_s == pytest.approx(end_s, abs=0.05)
