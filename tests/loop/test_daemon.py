"""The real-time loop: same endings as the lockstep, and the step's inputs from bus, clock, recorder and
operator.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from drivers.arrays import Rows, array_at
from drivers.compiled.compiler import INTEGER
from drivers.compiled.pointed import of_python
from drivers.errors import BusError
from drivers.frame_array import FRAME, NO_FRAMES, received_array, received_frames, sent_array, sent_frames
from drivers.protocol import Frame, Received
from drivers.signals import BusState, DriveMode, Mode
from hil.app.compose import build_nodes
from hil.app.sim.lockstep import Lockstep
from hil.contracts.messages import DeviceCommand, hear
from hil.loop.clock import Wake
from hil.loop.cycle import Cycle
from hil.loop.daemon import Shell, _ask, switch_off
from hil.loop.panel import OperatorPanel
from hil.loop.run_end import Course
from hil.signals import Operator, TickInput
from plant_fmu.drives import drives_end
from plant_fmu.faults.kinds import DriveSilence, EncoderJump, FramesLoss
from plant_fmu.faults.plan import FaultPlan
from tests.broad import broad
from tests.loop.bench import new_cycle
from tests.loop.wire import IDEAL, PERIOD_NS, Wire, daemon

LATE_NS, OUT_NS = 70_000, 123_000
TICKS = 6


@pytest.mark.parametrize(
    ("faults", "mode", "seconds"),
    broad(
        [
            ([], Mode.PARKED, None),
            ([FramesLoss()], Mode.WAITING, 2.0),
            ([FramesLoss(at_s=1.0)], Mode.FAULT, None),
            ([DriveSilence(leg=4, at_s=0.3)], Mode.HELD, None),
            ([EncoderJump(leg=5, by_m=0.3, at_s=1.1)], Mode.HELD, None),
            ([DriveSilence(leg=0)], Mode.WAITING, 10.0),
            ([DriveSilence(leg=2, at_s=1.2)], Mode.HELD, None),
        ],
        quick=5,
    ),
)
def test_real_time_loop_and_simulated_loop_end_in_the_same_mode_under_the_same_faults(faults, mode, seconds):
    stop_s = None if mode is Mode.WAITING else 1.4
    nodes, plant = build_nodes(IDEAL, FaultPlan(faults))
    rows: list[Any] = []
    there = Lockstep(new_cycle(IDEAL), nodes, (None,), 0.0).run(
        stop_s, lambda *args: rows.append(args[2].row)
    )
    plant.close()
    seen: list[Any] = []
    here, _ = daemon(
        *faults, course=lambda cycle: Course(cycle, stop_s), tick=lambda row, *_, **__: seen.append(row)
    )
    assert (here, here.story) == (there, there.story)
    assert here.mode is mode, here
    assert len(seen) == len(rows) == here.ticks + 1
    assert all((a["mode"], a["faults"]) == (b["mode"], b["faults"]) for a, b in zip(rows, seen, strict=True))
    if seconds is not None:
        assert here.ticks == round(seconds * IDEAL.loop.rate_Hz)


class Stamped(Wire):
    """A wire on which each SYNC is sent 123 us after the wake-up."""

    def sent_ns(self) -> list[int]:
        return [self.now() + OUT_NS]


def test_real_time_loop_records_when_each_drive_sampled_its_length():
    latched: list[list[int]] = []

    def tick(row: Any, *_: Any, **__: Any) -> None:
        latched.append(row["latch_ns"].tolist())
        if len(latched) == 3:
            raise RuntimeError("enough")

    daemon(kind=Stamped, tick=tick)
    assert latched == [[OUT_NS] * 6] * 3


# -- what the step gets ----------------------------------------------------------------------------------------


class Busy(Stamped):
    """A bus and a clock that report something in every tick, and refuse some frames.

    State: ticks in which frames were flushed, and the refused frames by tick.
    """

    def __init__(self, nodes: Any, refused: dict[tuple[int, str], int] | None = None) -> None:
        super().__init__(nodes)
        self.refused = refused or {}
        self.flushed: list[int] = []
        self.all_sent: list[Frame] = []
        self.asked = False
        self.allowed_ns: list[int] = []
        self.clock = SimpleNamespace(
            stretched=lambda: self.tick * (self.tick + 1), working=self.working, now=self.now
        )

    def working(self, allowed_ns: int) -> None:
        self.asked = True
        self.allowed_ns.append(allowed_ns)

    def now(self) -> int:
        return super().now() + LATE_NS

    def wait(self) -> Any:
        tick, t_ns, *_ = super().wait()
        self.asked = False
        return tick, t_ns, LATE_NS, tick % 3

    def send(self, frames: Any) -> int:
        self.all_sent += sent_frames(frames)
        return super().send(frames) + self.refused.get((self.tick, "command" if self.asked else "opening"), 0)

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
    inputs: list[TickInput] = []

    def course(cycle: Cycle) -> Course:
        step = cycle.step

        def watched(inp: TickInput) -> Any:
            inputs.append(inp)
            if len(inputs) > TICKS:
                raise RuntimeError("enough")
            return step(inp)

        cycle.step = watched  # type: ignore[method-assign]
        found = Course(cycle)
        found.commands = lambda tick, _said=(): (commands or {}).get(tick, ())  # type: ignore[method-assign, assignment]
        return found

    _, wire = daemon(kind=lambda nodes: Busy(nodes, refused), course=course, window_ns=window_ns)
    return inputs[:TICKS], wire


def test_each_control_step_gets_the_lateness_frame_losses_and_bus_skew_of_its_period():
    window_ns = PERIOD_NS // 4
    inputs, wire = looped(window_ns=window_ns)
    for tick, inp in enumerate(inputs):
        assert (inp.tick, inp.lateness_ns, inp.skipped) == (tick, LATE_NS, tick % 3)
        assert (inp.sync_skew_ns, inp.bus_errors, inp.bus_overflow) == (1000 + tick, 10 + tick, 20 + tick)
        assert inp.bus_state is BusState.WARNING
        assert (inp.recorder_dropped, inp.recorder_alive) == (5, True)
        assert set(inp.latch_ns) == {OUT_NS}, "from the wake-up on, however late that was"
        assert inp.stretched_ns == 2 * tick
    assert wire.allowed_ns[:TICKS] == [PERIOD_NS - window_ns] * TICKS, (
        "for a step where bench time stands still"
    )


def test_each_frame_refused_by_the_bus_is_reported_once_in_the_next_control_step():
    inputs, _ = looped({(1, "command"): 2, (2, "opening"): 1, (4, "opening"): 3})
    assert [inp.sends_failed for inp in inputs] == [0, 0, 3, 0, 3, 0]


@pytest.mark.parametrize(("operator", "tries"), [(Operator.RESET, 1), (Operator.STOP, 0)])
def test_reset_flushes_the_queued_frames_of_a_dead_bus(operator, tries):
    _, wire = looped(commands={3: (operator,)})
    assert wire.flushed.count(3) == tries


# -- the end ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("error", [KeyboardInterrupt, SystemExit])
def test_any_exception_in_the_loop_sends_off_commands_behind_the_queued_frames(error):
    wires: list[Busy] = []

    def kind(nodes: Any) -> Busy:
        wires.append(Busy(nodes))
        wires[0].period_ns = 1
        return wires[0]

    def course(cycle: Cycle) -> Course:
        def ends(_: TickInput) -> Any:
            wires[0].all_sent.clear()
            raise error

        cycle.step = ends  # type: ignore[method-assign, assignment]
        return Course(cycle)

    with pytest.raises(error):
        daemon(kind=kind, course=course)
    end = drives_end(new_cycle(IDEAL).parts.protocol)
    heard = [message for frame in wires[0].all_sent for message in hear(end, frame)]
    modes = [DriveMode(each.mode) for each in heard if isinstance(each, DeviceCommand)]
    assert modes == [DriveMode.OFF] * 5
    assert wires[0].flushed == []


class Refusing:
    """A bus that accepts commands in given turns, and none after a failed flush."""

    def __init__(self, taken: list[int], *, off: bool, flushes: bool = True) -> None:
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


SENT, REFUSED = ["sent"] * 5, ["refused"] * 5


@pytest.mark.parametrize(
    ("bus", "told", "done"),
    [
        *((Refusing([0], off=off), True, ["sent", *REFUSED[1:]]) for off in (False, True)),
        *((Refusing([4], off=off), True, [*REFUSED[1:], "sent"]) for off in (False, True)),
        (Refusing([], off=False), False, REFUSED * 2),
        (Refusing([], off=True), False, [*REFUSED, "flush", *REFUSED]),
        # a flooded bus without the right to drop frames: who tries is refused from then on
        *((Refusing(list(range(99)), off=off, flushes=False), True, SENT) for off in (False, True)),
        (Refusing(list(range(5, 99)), off=False), True, REFUSED + SENT),
        (Refusing(list(range(6, 99)), off=True), True, [*REFUSED, "flush", *SENT]),
    ],
)
def test_off_commands_after_an_exception_are_repeated_on_each_bus_that_accepted_none(bus, told, done):
    deadlines: Any = SimpleNamespace(tick=7, period_ns=1_000)
    assert switch_off(new_cycle(IDEAL), bus, deadlines) is told
    assert bus.done == done


# -- the window of the feedbacks -------------------------------------------------------------------------------


def in_python(function: Any, arguments: int) -> Any:
    """Function of integers that compiled code calls by its address."""
    address, keeps = of_python(function, *[INTEGER] * arguments)
    return SimpleNamespace(address=address, keeps=keeps)


class Tail:
    """A protocol whose answers carry no SYNC counter: an answer before the SYNC belongs to the SYNC before."""

    context, wanted = 0, (1, 2)

    def __init__(self, *, shares_identifiers: bool) -> None:
        self.traits = SimpleNamespace(feedback_ids={1, 2}, shares_identifiers=shares_identifiers)
        self.fresh_by, self.addressed_by = in_python(self._fresh, 4), in_python(lambda *_: 0, 2)

    def _fresh(self, _context: int, frame: int, _tick: int, since_ns: int) -> int:
        ((t_ns, answer),) = received_frames(array_at(frame, 1, FRAME))
        number = answer.data[0] if self.traits.shares_identifiers else answer.id
        return number if t_ns >= since_ns and number in self.wanted else 0


def heard_by(shared: bool, now: Any, next_one: Any, window_ns: int, wake: Wake) -> Rows:
    """Frames that a tick receives on such a bus."""
    bus: Any = SimpleNamespace(
        clock=SimpleNamespace(now=now), drain_now=lambda: NO_FRAMES, send=lambda _: 0, sent_ns=list,
        **{"wait" if shared else "drain": next_one},
    )  # fmt: skip
    cycle: Any = SimpleNamespace(parts=SimpleNamespace(protocol=Tail(shares_identifiers=shared)))
    nothing: Any = None
    shell = Shell(bus, nothing, nothing, OperatorPanel(), window_ns)
    return _ask(cycle, shell, wake, sent_array([Frame(1, b"")]))[0]


@pytest.mark.parametrize(("window_ns", "last"), [(145, 150), (140, 140), (141, 150)])
@pytest.mark.parametrize("shared", [False, True])
def test_wait_for_feedback_ends_in_time_under_a_flood_of_foreign_frames(shared, window_ns, last):
    clock, looks = [100], list[int]()

    def next_one(_deadline_ns: int, _wanted: Any = None) -> Rows:
        clock[0] += 10
        looks.append(clock[0])
        assert len(looks) < 20, "the loop waits on although the window is over"
        return received_array([Received(clock[0], Frame(7, bytes([7]))), Received(clock[0], Frame(1, b"\1"))])

    heard = heard_by(shared, lambda: clock[0], next_one, window_ns, Wake(0, 0, 0, 0))
    assert looks == [*range(110, last + 10, 10)]
    assert len(heard) == 2 * len(looks), "what has come by then counts"
