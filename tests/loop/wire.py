"""The ideal bus of a lockstep with the interface that the daemon uses, and runs of the daemon on it."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

from drivers.frame_array import received_array, sent_frames
from drivers.protocol import Received
from drivers.signals import BusState
from hil.app.compose import build_nodes
from hil.app.configuration.configuration import load
from hil.loop.cycle import Cycle
from hil.loop.daemon import Shell, run
from hil.loop.panel import OperatorPanel
from hil.loop.run_end import Course, Ending
from plant_fmu.faults.fault import Fault
from plant_fmu.faults.plan import FaultPlan
from tests.loop.bench import new_cycle

IDEAL = load("ideal")
PERIOD_NS = round(1e9 / IDEAL.loop.rate_Hz)


class Wire:
    """Bus, clock and deadlines of a daemon. State: the tick, and the frames under way."""

    def __init__(self, nodes: Any, period_ns: int = PERIOD_NS) -> None:
        self.nodes, self.period_ns, self.tick = nodes, period_ns, -1
        self.period_s = 0.0
        self.commands: list[Any] = []
        self.answers: list[Any] = []
        self.late: list[Any] = []
        self.clock: Any = SimpleNamespace(stretched=lambda: 0, working=lambda _: None, now=self.now)
        nodes.start(0)

    def now(self) -> int:
        return int(self.tick * self.period_ns)

    def wait(self) -> Any:
        self.tick += 1
        return self.tick, self.tick * self.period_ns, 0, 0

    def skew_ns(self) -> int:
        return 0

    def sent_ns(self) -> list[int]:
        return []

    def flush_tx(self) -> None:
        pass

    def send(self, frames: Any) -> int:
        t_ns = self.tick * self.period_ns
        self.commands += [Received(t_ns, frame) for frame in sent_frames(frames)]
        if not self.answers:
            self.answers = [Received(*reply) for reply in self.nodes.step(t_ns, self.commands)] or [None]
            self.commands = []
        return 0

    def drain_now(self) -> Any:
        late, self.late, self.answers = self.late, [], []
        return received_array(late)

    def drain(self, _deadline_ns: int, wanted: Any) -> Any:
        """The feedbacks; a status frame loses arbitration against the last of them, and is late."""
        answers = [answer for answer in self.answers if answer is not None]
        self.answers = [None]
        self.late += [answer for answer in answers if answer.frame.id not in wanted]
        return received_array([answer for answer in answers if answer.frame.id in wanted])

    def events(self) -> Any:
        return SimpleNamespace(errors=0, off=0, overflow=0, state=BusState.UNKNOWN)


def daemon(
    *faults: Fault,
    kind: Callable[[Any], Any] = Wire,
    course: Callable[[Cycle], Course] = Course,
    tick: Callable[..., None] = lambda *_, **__: None,
    **shell: Any,
) -> tuple[Ending, Any]:
    """Run the daemon on the ideal configuration; return its ending and its wire. `tick` receives each row."""
    nodes, plant = build_nodes(IDEAL, FaultPlan(faults))
    wire = kind(nodes)
    recording: Any = SimpleNamespace(alive=True, dropped=5, tick=tick, event=lambda *_: None)
    panel, window_ns = shell.pop("panel", OperatorPanel()), shell.pop("window_ns", 0)
    try:
        return run(course(new_cycle(IDEAL)), Shell(wire, wire, recording, panel, window_ns, **shell)), wire
    finally:
        plant.close()
