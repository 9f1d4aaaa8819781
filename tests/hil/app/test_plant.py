"""`hil plant`: its end, its log, and faults of its process."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from math import inf
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from drivers.arrays import Array, Rows
from drivers.config import DriveSettings
from drivers.errors import PlantError
from drivers.frame_array import received_array
from drivers.protocol import Frame, Received
from hil.app import plant
from hil.app.compose import build_nodes, build_protocol
from hil.app.configuration.configuration import load
from hil.app.plant import ProcessFaults
from hil.app.plant_rows import PLANT, plant_row
from hil.loop.clock import RealTime
from hil.record import Recording
from hil.record.log import Log
from plant_fmu.config import DriveEmulation
from plant_fmu.drives.nodes import Nodes
from plant_fmu.faults.kinds import EncoderFreeze, ProcessSlow
from plant_fmu.plant import Plant, Truth
from tests.drivers.legs_frames import opening

MS = 1_000_000
DIED = "its process died of SIGKILL"


class Legs(Plant):
    """Six legs of 1.5 m. State: time, whether it is alive.

    rates : m/s, as a function of time; dies_s : end of its life; resets : number of resets that it survives.
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

    def close(self) -> None:
        """Nothing to free."""


class Asked:
    """Bus with a SYNC every `period_ns`. State: its time and the number of the SYNC."""

    def __init__(self, sync: Callable[[int], Frame], period_ns: int) -> None:
        self.t_ns = 0
        self.clock = SimpleNamespace(now=lambda: self.t_ns, leave=lambda: None)
        self._sync, self._period_ns = sync, period_ns

    def drain_now(self) -> Rows:
        self.t_ns += self._period_ns
        return received_array([Received(self.t_ns, self._sync(self.t_ns // self._period_ns))])

    def send(self, _frames: Rows) -> None:
        """Discard the answers."""


class Kept:
    """Stand-in for a recording that keeps its input."""

    def __init__(self) -> None:
        self.events: list[tuple[str, str]] = []
        self.closed: dict[str, Any] = {}

    def tick(self, *_: Any) -> None:
        """Discard the row."""

    def event(self, _t_ns: int, level: str, text: str) -> None:
        self.events.append((level, text))

    def close(self, ending: dict[str, Any]) -> Any:
        self.closed = ending
        return SimpleNamespace(path="a.mcap", dropped=0, lost=0, complete=True, gave_up=False, error="")


@pytest.fixture
def serve(monkeypatch):
    """Send SYNC every `period_ns` for 50 ms, or until an orphaned plant ends."""

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
def test_dead_plant_is_a_failure_in_summary_and_log(serve, legs):
    summary, log, _ = serve(legs())
    assert (summary["success"], summary["trouble"]) == (False, DIED)
    assert summary["final_states"] == ["BOOT"] * 6
    assert ("error", DIED) in log.events
    assert log.closed["trouble"] == DIED


@pytest.mark.parametrize("rate_m_s", [0.3, -0.3])
@pytest.mark.parametrize(("rests_s", "end_s"), [(inf, plant.ORPHAN_S), (1.0, 1.2), (0.0, 0.2)])
def test_orphaned_plant_ends_at_rest_or_after_a_timeout(serve, rate_m_s, rests_s, end_s):
    """The daemon has ended before the start. All legs but one move."""
    moving, still = [rate_m_s] * 5 + [0.0], [0.0] * 6
    legs = Legs(lambda t_s: moving if t_s < rests_s else still)
    summary, _, ended_s = serve(legs, period_ns=10 * MS, orphan=True)
    assert summary["ending"] == "orphaned"
    assert ended_s == pytest.approx(end_s, abs=0.05)


def test_true_state_of_the_plant_is_restored_from_its_log(tmp_path):
    nodes, physics = build_nodes(load("virtual"))
    nodes.start(0)
    nodes.step(5_000_000, ())
    snapshot = nodes.snapshot()
    physics.close()
    with Recording.start(tmp_path / "a.mcap", configuration="", table=PLANT, lockstep=True) as recording:
        recording.tick(plant_row(0, snapshot), (), ())
    row = Log.open(tmp_path / "a.mcap").rows()[0]
    assert snapshot.truth is not None
    assert row["length"].tobytes() == snapshot.length.tobytes()
    assert row["R"].tobytes() == np.ascontiguousarray(snapshot.truth.R).tobytes()
    with (tmp_path / "a.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        seen = next(d for _, _, _, d in reader.iter_decoded_messages(["/plant"]))
    assert seen.length.leg_3 == snapshot.length[3]
    assert (seen.p.z, seen.R.yz) == (snapshot.truth.p[2], snapshot.truth.R[1, 2])
    assert seen.drive_state_number.leg_5 == snapshot.state[5]


LOOP = """
import sys, time
from hil.app.configuration.fault_words import read_fault
from hil.app.plant import ProcessFaults
faults, begun = ProcessFaults([read_fault(sys.argv[1])], 0), time.monotonic()
print("loops", flush=True)
t_ns = 0
while t_ns < 1_000_000_000:
    faults.strike(t_ns)
    t_ns += 10_000_000
    time.sleep(0.005)
print("done", flush=True)
"""


def looping(words: str) -> subprocess.Popen[str]:
    process = subprocess.Popen([sys.executable, "-c", LOOP, words], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stdout.readline() == "loops\n"
    return process


def test_fault_process_kill_ends_the_plant_process():
    with looping("process_kill at=0.2") as process:
        assert process.wait(30) == -signal.SIGKILL


def test_fault_process_stop_suspends_the_plant_process_for_its_duration():
    with looping("process_stop at=0.2 for=0.5") as process:
        stat = Path(f"/proc/{process.pid}/stat")
        stopped = []
        while process.poll() is None:
            if stat.read_text().rpartition(")")[2].split()[0] == "T":
                stopped.append(time.monotonic())
            time.sleep(0.01)
        assert process.returncode == 0
        assert stopped[-1] - stopped[0] == pytest.approx(0.5, abs=0.3)


def test_fault_process_slow_delays_each_plant_step_while_it_is_present():
    faults = ProcessFaults([ProcessSlow(by_ms=50.0, at_s=1.0, for_s=1.0), EncoderFreeze(leg=0)], 0)
    took = []
    for t_s in (0.9, 1.0, 1.5, 2.0, 2.1):
        begun = time.monotonic()
        faults.strike(round(t_s * 1e9))
        took.append(time.monotonic() - begun)
    assert [t >= 0.05 for t in took] == [False, True, True, False, False]
