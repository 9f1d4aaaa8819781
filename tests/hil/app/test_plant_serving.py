"""What `hil plant` waits for, and for whom."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from drivers.arrays import Rows
from drivers.errors import RunError
from drivers.frame_array import NO_FRAMES, sent_frames, timed_array
from drivers.protocol import Frame
from hil.app import plant
from hil.app.compose import build_protocol
from hil.app.configuration.configuration import load
from hil.contracts.records import record_of

LATER = Frame(5, b"later")


class Waited:
    """A bus on which nothing comes. State: its time, until when was waited, and when what was sent."""

    def __init__(self) -> None:
        self.t_ns = 1_000
        self.clock = SimpleNamespace(now=lambda: self.t_ns)
        self.deadlines: list[int] = []
        self.sent: list[tuple[int, Frame]] = []

    def drain_now(self) -> Rows:
        return NO_FRAMES

    def wait(self, deadline_ns: int) -> Rows:
        self.deadlines.append(deadline_ns)
        self.t_ns = deadline_ns
        return NO_FRAMES

    def send(self, frames: Rows) -> None:
        self.sent += [(self.t_ns, frame) for frame in sent_frames(frames)]


class Timer:
    """When the next drive speaks: at first_ns, and every period_ns."""

    def __init__(self, first_ns: int = 1 << 62, period_ns: int = 0) -> None:
        self.next_ns, self._period_ns = first_ns, period_ns

    def speak(self) -> None:
        self.next_ns += self._period_ns


class Drives(SimpleNamespace):
    """Six drives with a timer."""

    @property
    def next_reading_ns(self) -> int:
        return int(self.readings.next_ns)


def advancing(step: Any) -> Any:
    """Return the drives' pass of what they do, in frames."""
    return lambda now_ns, received: timed_array(step(now_ns, received))


def serve(bus: Waited, stop: plant._Stop, step: Any, readings: Timer) -> None:
    """Serve until the stop, with `step` for what the drives do, and their timer."""
    nodes = Drives(start=lambda _: None, advance=advancing(step), snapshot=record_of, readings=readings)
    bench = plant.Bench(nodes, None, lambda: None)  # type: ignore[arg-type]
    faults = SimpleNamespace(strike=lambda _: None)
    plant._serve(bench, bus, None, stop, None, None, faults, build_protocol(load("virtual")))  # type: ignore[arg-type]


def test_a_frame_that_waits_out_its_latency_goes_onto_the_bus_at_its_time():
    bus, stop = Waited(), plant._Stop()
    steps = iter([[(301_000, LATER)], [], []])

    def step(now_ns: int, _received: Any) -> list[tuple[int, Frame]]:
        found = next(steps)
        if len(bus.deadlines) == 3:
            stop.reason = "enough"
        return [(now_ns + t_ns, frame) for t_ns, frame in found]

    serve(bus, stop, step, Timer())
    idle = plant.IDLE_NS
    first = 1_000 + idle
    assert bus.deadlines == [first, first + 301_000, first + 301_000 + idle]
    assert bus.sent == [(first + 301_000, LATER)]


@pytest.mark.parametrize(("supervisor", "patience_s"), [(None, 0.0), (3, plant.ORPHAN_S + plant.CLOSING_S)])
def test_the_plant_of_a_run_waits_for_the_orphan_of_the_one_before_and_any_other_is_refused_at_once(
    monkeypatch, supervisor, patience_s
):
    asked = []

    def refused(_c: Any, patience: float) -> Any:
        asked.append(patience)
        raise RunError("in use")

    monkeypatch.setattr(plant, "_open_bus", refused)
    with pytest.raises(RunError, match="in use"):
        plant.run_plant(load("virtual"), supervisor=supervisor)
    assert asked == [patience_s]
