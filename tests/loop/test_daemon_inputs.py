"""What the real-time loop tells the step of its bus, its clock and its recorder, and what it does at its end."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from drivers.arrays import Rows, array_at
from drivers.errors import BusError
from drivers.frame_array import FRAME, NO_FRAMES, received_array, received_frames, sent_array, sent_frames
from drivers.protocol import Frame, Received
from drivers.signals import BusState, DriveMode, Mode
from hil.app.compose import build_cycle, build_nodes
from hil.app.configuration.configuration import load
from hil.contracts.messages import DeviceCommand, hear
from hil.loop.clock import Wake
from hil.loop.daemon import Shell, _ask, run, switch_off
from hil.loop.panel import OperatorPanel
from hil.loop.run_end import Course
from hil.operate.channel import Heard
from hil.signals import Operator, Order, TickInput
from plant_fmu.drives import drives_end
from tests.drivers.stub_protocol import InPython
from tests.loop.test_run_end_daemon import Wire

LATE_NS, OUT_NS = 70_000, 123_000
TICKS = 6


class Busy(Wire):
    """A bus and a clock with something to tell in every tick, and frames that are refused.

    State: how often frames were called back, and in which tick which frames are refused.
    """

    def __init__(self, nodes: Any, period_ns: int, refused: dict[tuple[int, str], int] | None = None) -> None:
        super().__init__(nodes, period_ns)
        self.refused = refused or {}
        self.flushed: list[int] = []
        self.all_sent: list[Frame] = []
        self.asked = False
        self.allowed_ns: list[int] = []
        self.clock: Any = SimpleNamespace(
            stretched=lambda: self.tick * (self.tick + 1), working=self.working, now=self.now
        )

    def working(self, allowed_ns: int) -> None:
        self.asked = True
        self.allowed_ns.append(allowed_ns)

    def now(self) -> int:
        return int(self.tick * self.period_ns) + LATE_NS

    def wait(self) -> Any:
        tick, t_ns, *_ = super().wait()
        self.asked = False
        return tick, t_ns, LATE_NS, tick % 3

    def send(self, frames: Any) -> int:
        what = "command" if self.asked else "opening"
        self.all_sent += sent_frames(frames)
        return int(super().send(frames)) + self.refused.get((self.tick, what), 0)

    def sent_ns(self) -> list[int]:
        return [self.now() + OUT_NS]

    def skew_ns(self) -> int:
        return 1000 + self.tick

    def flush_tx(self) -> None:
        self.flushed.append(self.tick)

    def events(self) -> Any:
        return SimpleNamespace(errors=10 + self.tick, off=0, overflow=20 + self.tick, state=BusState.WARNING)


def looped(
    refused: dict[tuple[int, str], int] | None = None,
    commands: dict[int, tuple[Operator, ...]] | None = None,
    window_ns: int = 0,
) -> tuple[list[TickInput], Busy]:
    """Run some ticks; return the inputs of the step, and the wire."""
    c = load("ideal")
    nodes, plant = build_nodes(c)
    wire = Busy(nodes, round(1e9 / c.loop.rate_Hz), refused)
    cycle = build_cycle(c, c.loop.rate_Hz, 1e-3 * c.drives.watchdog_ms)
    step, inputs = cycle.step, list[TickInput]()

    def watched(inp: TickInput) -> Any:
        inputs.append(inp)
        if len(inputs) > TICKS:
            raise RuntimeError("enough")
        return step(inp)

    cycle.step = watched  # type: ignore[method-assign]
    course = Course(cycle)
    course.commands = lambda tick, _said=(): (commands or {}).get(tick, ())  # type: ignore[method-assign, assignment]
    recording = SimpleNamespace(alive=True, dropped=5, tick_of_items=lambda *_: None, event=lambda *_: None)
    run(course, Shell(wire, wire, recording, OperatorPanel(), window_ns))  # type: ignore[arg-type]
    plant.close()
    return inputs[:TICKS], wire


def test_the_step_is_told_what_was_late_lost_and_skewed_in_its_tick():
    inputs, _ = looped()
    for tick, inp in enumerate(inputs):
        assert (inp.tick, inp.lateness_ns, inp.skipped) == (tick, LATE_NS, tick % 3)
        assert (inp.sync_skew_ns, inp.bus_errors, inp.bus_overflow) == (1000 + tick, 10 + tick, 20 + tick)
        assert inp.bus_state is BusState.WARNING
        assert inp.recorder_dropped == 5
        assert inp.recorder_alive
    assert [inp.stretched_ns for inp in inputs] == [2 * tick for tick in range(TICKS)]


@pytest.mark.parametrize("share", [0.0, 0.25, 0.75])
def test_on_a_bench_whose_time_stands_still_a_step_may_take_what_the_window_leaves_of_the_period(share):
    period_ns = round(1e9 / load("ideal").loop.rate_Hz)
    window_ns = round(share * period_ns)
    _, wire = looped(window_ns=window_ns)
    assert wire.allowed_ns[:TICKS] == [period_ns - window_ns] * TICKS


def test_when_a_drive_latched_counts_from_the_wake_up_however_late_that_was():
    inputs, _ = looped()
    assert {latch for inp in inputs for latch in inp.latch_ns} == {OUT_NS}


def test_frames_that_the_bus_refused_are_told_once_each_in_the_next_step():
    inputs, _ = looped({(1, "command"): 2, (2, "opening"): 1, (4, "opening"): 3})
    assert [inp.sends_failed for inp in inputs] == [0, 0, 3, 0, 3, 0]


def test_the_step_is_told_what_came_over_the_channel_and_the_course_what_enter_said():
    c = load("ideal")
    nodes, plant = build_nodes(c)
    wire = Busy(nodes, round(1e9 / c.loop.rate_Hz))
    cycle = build_cycle(c, c.loop.rate_Hz, 1e-3 * c.drives.watchdog_ms)
    cycle.mode, inputs = Mode.IDLE, list[TickInput]()

    def ends(inp: TickInput) -> Any:
        inputs.append(inp)
        raise RuntimeError("enough")

    cycle.step = ends  # type: ignore[method-assign]
    said = Heard((Operator.STOP,), orders=(Order(Operator.KEY),))
    channel: Any = SimpleNamespace(take=lambda *, anew: said, waited_for=False, old=frozenset())
    recording: Any = SimpleNamespace(alive=True, dropped=0)
    shell: Any = Shell(wire, wire, recording, OperatorPanel(), 0, channel, lambda: True)  # type: ignore[arg-type]
    run(Course(cycle, armed=False), shell)
    plant.close()
    assert [inp.operator for inp in inputs] == [(Operator.ENGAGE, Operator.STOP)]
    assert [inp.orders for inp in inputs] == [(Order(Operator.KEY),)]


@pytest.mark.parametrize(("operator", "tries"), [(Operator.RESET, 1), (Operator.STOP, 0)])
def test_a_reset_calls_the_frames_of_a_dead_bus_back(operator, tries):
    _, wire = looped(commands={3: (operator,)})
    assert wire.flushed.count(3) == tries


def modes(wire: Busy, protocol: Any) -> list[DriveMode]:
    end = drives_end(protocol)
    heard = [message for frame in wire.all_sent for message in hear(end, frame)]
    return [DriveMode(each.mode) for each in heard if isinstance(each, DeviceCommand)]


@pytest.mark.parametrize("error", [KeyboardInterrupt, SystemExit])
def test_whatever_leaves_the_loop_the_drives_are_told_to_switch_off_behind_all_that_waited(error):
    c = load("ideal")
    nodes, plant = build_nodes(c)
    wire = Busy(nodes, 1)
    cycle = build_cycle(c, c.loop.rate_Hz, 0.01)

    def ends(_: TickInput) -> Any:
        wire.all_sent.clear()
        raise error

    cycle.step = ends  # type: ignore[method-assign, assignment]
    recording = SimpleNamespace(alive=True, dropped=0)
    with pytest.raises(error):
        run(Course(cycle), Shell(wire, wire, recording, OperatorPanel(), 0))  # type: ignore[arg-type]
    plant.close()
    assert wire.flushed == []
    assert modes(wire, cycle.parts.protocol) == [DriveMode.OFF] * 5


class Refusing:
    """A bus that takes the commands of some turns, and none once it could not be flushed."""

    def __init__(self, taken: list[int], *, off: bool, flushes: bool) -> None:
        self.taken, self.off, self.flushes, self.done = taken, off, flushes, list[str]()

    def events(self) -> Any:
        return SimpleNamespace(off=int(self.off))

    def flush_tx(self) -> None:
        self.done.append("flush")
        if not self.flushes:
            self.taken = []
            raise BusError("no right")

    def send(self, _: Any) -> int:
        taken = len(self.done) in self.taken
        self.done.append("sent" if taken else "refused")
        return 0 if taken else 1


@pytest.fixture(scope="module")
def cycle():
    return build_cycle(load("ideal"), 1000.0, 0.01)


def switched_off(cycle: Any, bus: Refusing) -> bool:
    return switch_off(cycle, bus, SimpleNamespace(tick=7, period_ns=1_000))  # type: ignore[arg-type]


@pytest.mark.parametrize("off", [False, True])
@pytest.mark.parametrize(("taken", "told"), [([0], True), ([4], True), ([], False)])
def test_one_whole_command_that_the_bus_took_has_told_the_drives(cycle, taken, told, off):
    assert switched_off(cycle, Refusing(taken, off=off, flushes=True)) is told


@pytest.mark.parametrize("off", [False, True])
def test_frames_that_cannot_be_dropped_keep_no_drive_from_being_told_to_switch_off(cycle, off):
    """As a flooded bus does where the program lacks the right: who tries to drop them is refused from then on."""
    bus = Refusing(list(range(99)), off=off, flushes=False)
    assert switched_off(cycle, bus)
    assert bus.done == ["sent"] * 5


@pytest.mark.parametrize(("off", "between"), [(False, []), (True, ["flush"])])
def test_a_bus_that_took_no_command_is_given_them_again_and_flushed_if_it_is_off(cycle, off, between):
    bus = Refusing(list(range(6, 99)) if off else list(range(5, 99)), off=off, flushes=True)
    assert switched_off(cycle, bus)
    assert bus.done == ["refused"] * 5 + between + ["sent"] * 5


class Tail:
    """A protocol whose answers name no SYNC: what came before it was asked for is an answer to the one before."""

    context, wanted = 0, (1, 2)

    def __init__(self, *, shares_identifiers: bool) -> None:
        self.traits = SimpleNamespace(feedback_ids={1, 2}, shares_identifiers=shares_identifiers)
        self.fresh_by, self.addressed_by = InPython(self._fresh, 4), InPython(lambda *_: 0, 2)

    def _fresh(self, _context: int, frame: int, _tick: int, since_ns: int) -> int:
        ((t_ns, answer),) = received_frames(array_at(frame, 1, FRAME))
        number = answer.data[0] if self.traits.shares_identifiers else answer.id
        return number if t_ns >= since_ns and number in self.wanted else 0


@pytest.mark.parametrize("shared", [False, True])
def test_after_a_late_wake_up_old_answers_do_not_end_the_wait_and_the_window_is_no_longer(shared):
    def frame(number: int) -> Frame:
        return Frame(9, bytes([number])) if shared else Frame(number, b"\0")

    coming = [
        Received(10, frame(1)),
        Received(120, frame(2)),
        Received(130, frame(1)),
        Received(140, frame(2)),
    ]
    deadlines = []

    def next_one(deadline_ns: int, _wanted: Any = None) -> Rows:
        deadlines.append(deadline_ns)
        return received_array([coming.pop(0)])

    refusing = SimpleNamespace(side_effect=None)
    bus = SimpleNamespace(
        clock=SimpleNamespace(now=lambda: 100), drain_now=lambda: NO_FRAMES, send=lambda _: 0, sent_ns=list,
        wait=next_one if shared else refusing, drain=refusing if shared else next_one,
    )  # fmt: skip
    cycle: Any = SimpleNamespace(parts=SimpleNamespace(protocol=Tail(shares_identifiers=shared)))
    shell = Shell(bus, None, None, OperatorPanel(), 175)  # type: ignore[arg-type]
    heard, _, _ = _ask(cycle, shell, Wake(0, 0, 90, 0), sent_array([frame(0)]))
    assert heard["t_ns"].tolist() == [10, 120, 130]
    assert len(coming) == 1
    assert set(deadlines) == {175}


@pytest.mark.parametrize(("window_ns", "last"), [(145, 150), (140, 140), (141, 150)])
@pytest.mark.parametrize("shared", [False, True])
def test_the_window_ends_at_its_time_however_many_frames_of_others_come(shared, window_ns, last):
    clock, looks = [100], list[int]()

    def next_one(deadline_ns: int, _wanted: Any = None) -> Rows:
        clock[0] += 10
        looks.append(clock[0])
        assert len(looks) < 20, "it waits on"
        return received_array([Received(clock[0], Frame(7, bytes([7]))), Received(clock[0], Frame(1, b"\1"))])

    bus = SimpleNamespace(
        clock=SimpleNamespace(now=lambda: clock[0]), drain_now=lambda: NO_FRAMES, send=lambda _: 0, sent_ns=list,
        wait=next_one, drain=next_one,
    )  # fmt: skip
    cycle: Any = SimpleNamespace(parts=SimpleNamespace(protocol=Tail(shares_identifiers=shared)))
    shell = Shell(bus, None, None, OperatorPanel(), window_ns)  # type: ignore[arg-type]
    heard, _, _ = _ask(cycle, shell, Wake(0, 0, 0, 0), sent_array([Frame(1, b"")]))
    assert looks == [*range(110, last + 10, 10)]
    assert len(heard) == 2 * len(looks), "what has come by then counts"
