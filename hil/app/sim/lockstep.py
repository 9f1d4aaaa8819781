"""Simulates both ends of the buses in one process, in simulated time, with the virtual bus's timing.

A frame takes its worst-case bit time, and the lowest identifier wins arbitration.
"""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from math import inf
from time import perf_counter
from typing import Any

import numpy as np

from drivers.arrays import Ints, Rows, array_at
from drivers.can.bus_time import BitTiming, frame_time_ns
from drivers.compiled.pointed import data_at
from drivers.errors import BusError, PlantError
from drivers.family import Family
from drivers.frame_array import FRAME, NO_FRAMES, sent_frames
from drivers.protocol import ALWAYS
from drivers.signals import BusState, Mode
from hil.app.sim import tick_kernels as at
from hil.app.sim.tick_kernels import LOCKSTEP, advance
from hil.app.sim.wire_kernels import FLAGS, FULL, LENGTHS, ROW, WIRES
from hil.loop.console import refusal, setpoint_refusals
from hil.loop.cycle import Cycle
from hil.loop.run_end import Course, Ending
from hil.loop.story.narrator import EventSink, no_event
from hil.loop.tick_input import input_of
from hil.loop.tick_row import CAPACITY, NOTHING, Given, TickRow, Ticks
from hil.signals import Operator, Order, SetPoint, TickInput, TickOutput
from plant_fmu.drives.nodes import Nodes

_ROOM = 128
FRAME_WORDS = FRAME.itemsize // 8


@cache
def frame_times_ns(timing: BitTiming | None) -> Ints:
    """Worst-case duration of frames, ns, by data length and flags; -1: invalid frame; 0 without timing."""
    times = np.zeros((LENGTHS, FLAGS), np.int64)
    if timing is not None:
        times[:] = -1
        for length, flags in np.ndindex(LENGTHS, FLAGS):
            with suppress(BusError):
                times[length, flags] = frame_time_ns(length, flags, timing)
    return times


class Wires:
    """Buses between both ends of a simulation: data of the kernels `begin`, `answer` and `command`.

    Mutable state: the transmit queue, when each bus falls free, the frames on their way to either end.
    """

    def __init__(self, timings: Sequence[BitTiming | None], protocol: Family) -> None:
        """timings: bit timing of each bus, None if frames take no time; protocol: of the controller's end."""
        self._timings, self._protocol = timings, protocol
        self.times_ns = np.array(list(map(frame_times_ns, timings)))
        self._free = np.full(len(timings), ALWAYS)
        self.wanted = list(protocol.wanted) if protocol.traits.feedback_ids else []
        """Identifiers of the answers to a SYNC or poll."""
        self._wanted = np.array(self.wanted, np.int64)
        self._missing = np.zeros_like(self._wanted)
        self.record = w = np.zeros((), WIRES)
        w["buses"], w["free"], w["times"] = len(timings), data_at(self._free), data_at(self.times_ns)
        w["fresh"], w["addressed"] = protocol.fresh_by.address, protocol.addressed_by.address
        w["tables"] = protocol.context
        w["wanted_at"], w["wanted"], w["missing_at"] = (
            data_at(self._wanted), self._wanted.size, data_at(self._missing)
        )  # fmt: skip
        self._queue, self._commands, self._late = (np.zeros(0, np.int64) for _ in range(3))
        self._reserve(_ROOM)

    def _reserve(self, room: int) -> None:
        w = self.record
        held = (self._queue, self._commands, self._late)
        new = [np.zeros(room * size, np.int64) for size in (ROW, FRAME_WORDS, FRAME_WORDS)]
        for into, before in zip(new, held, strict=True):
            into[: before.size] = before
        self._queue, self._commands, self._late = new
        w["queue"], w["commands_at"], w["late_at"], w["room"] = *map(data_at, new), room
        self.commands: Rows = self._commands.view(FRAME)
        """Frames for the drives: the first `record["commands"]`."""
        self.late: Rows = self._late.view(FRAME)
        """Frames for the controller: the first `record["taken"]`, then later ones."""

    def settle(self, status: int, frames: Rows) -> None:
        """Make room after a kernel's status FULL, so that the kernel can be called again.

        Raises BusError for a frame that no bus can carry.
        """
        if status == FULL:
            self._reserve(2 * (int(self.record["room"]) + len(frames)))
            return
        for frame in sent_frames(frames):
            timing = self._timings[frame.bus]
            if timing is not None:
                frame_time_ns(len(frame.data), frame.flags % FLAGS, timing)


Observer = Callable[[TickInput, Rows, TickOutput], None]
"""Called after every tick with its input, the opening frames and the output."""
Taker = Callable[[Ticks, slice, "Given"], None]
"""Called with ticks that are done, the slice of new ones, and the operator's input of the first new one."""

COMPUTE_US = 60.0
"""Simulated time from the last feedback to the command's entry into the bus."""
LONGEST_S = 0.1
"""Target duration of a call for many ticks, in real time: Ctrl-C waits for its end."""
REST_S = 0.1
"""Time at rest in TRACKING after which the reference counts as HOLD, for faults that wait for it."""


def _frames(at: Any, count: Any) -> Rows:
    return array_at(int(at), int(count), FRAME) if count else NO_FRAMES


@dataclass
class Lockstep:
    """Advances controller (Cycle), buses, and emulated drives with plant (Nodes) tick by tick.

    Faults of the nodes that wait for a mode are notified when the controller reaches it.

    Mutable state: the wires, the row of ticks, the tick, the last mode, the time at rest; the controller and
    the nodes. One run per instance.
    """

    cycle: Cycle
    nodes: Nodes
    timings: Sequence[BitTiming | None]
    """Of each bus; None for an ideal one: frames take no time, force and measurement are simultaneous."""
    feedback_window_s: float
    compute_us: float = COMPUTE_US
    tick: int = -1
    """The last tick; both ends begin with the next."""
    _mode: Mode = Mode.WAITING
    _rests: int = 0
    """Number of consecutive ticks with the reference at rest in TRACKING."""

    def __post_init__(self) -> None:
        cycle, protocol = self.cycle, self.cycle.parts.protocol
        self.period_ns = round(1e9 / cycle.parts.rate_Hz)
        self.wires = Wires(self.timings, protocol)
        self._all_buses = (1 << len(self.timings)) - 1
        self.row = TickRow(cycle, LOCKSTEP, advance, self._attend)
        s: Any = self.row.record
        s["wires"] = data_at(self.wires.record)
        s["period_ns"], s["window_ns"] = self.period_ns, round(self.feedback_window_s * 1e9)
        s["compute_ns"] = round(self.compute_us * 1e3) if self.timings[0] else 0
        s["unasked"], s["tick"] = self.nodes.unasked, self.tick + 1
        self._replies = NO_FRAMES
        self.nodes.start((self.tick + 1) * self.period_ns)

    def step(
        self,
        operator: tuple[Operator, ...] = (),
        setpoints: tuple[SetPoint, ...] = (),
        orders: tuple[Order, ...] = (),
    ) -> tuple[TickInput, Rows, TickOutput]:
        """Advance both ends by one tick with operator input; return (input, opening frames, output)."""
        k = self.advance(1, Given(operator, orders, setpoints)).start
        ticks = self.row.ticks
        heard, opened, sent = ticks.spans(k)
        row, frames = ticks.row(k), ticks.frames
        inp = input_of(row, frames[heard], operator, setpoints, orders)
        return inp, frames[opened], TickOutput(frames[sent], row)

    def advance(self, count: int, given: Given = NOTHING) -> slice:
        """Advance both ends by up to `count` ticks: fewer at the end of `row.ticks` or at a decision.

        given: operator input of the first tick. Returns the slice of new ticks, which `row.new` has after an
        error.
        """
        row = self.row
        self._look_at_nodes()
        try:
            new = row.go(count, given)
        except BaseException:
            self.tick = int(row.record["tick"])
            raise
        self.tick = int(row.record["tick"]) - 1
        if self.nodes.waiting:
            self._report_mode()
        return new

    def _look_at_nodes(self) -> None:
        """Copy address and bus state of the nodes, which faults may change, into the compiled record."""
        s, off = self.row.record, self.nodes.bus_off & self._all_buses
        s["nodes"] = self.nodes.address
        s["bus_off"], s["bus_state"] = off, BusState.OFF if off else BusState.UNKNOWN

    def _attend(self, stage: int, stopped: int) -> None:
        """Do the part of a bus stage that needs Python, when the compiled tick stops there."""
        s: Any = self.row.record
        match stage:
            case at.HEAR | at.LIVE:
                self._live(stopped, first=stage == at.HEAR)
            case at.SYNC:
                self.wires.settle(stopped, _frames(s["starts"], s["begins"]))
            case at.PASS | at.ANSWER:
                self.wires.settle(stopped, _frames(s["replies"], s["replied"]))
            case _:
                self.wires.settle(stopped, _frames(s["frames"] + s["used"] * FRAME.itemsize, s["sent"]))

    def _live(self, stopped: int, *, first: bool) -> None:
        """Advance the drives: in stage HEAR to the tick's begin, else to the end of its SYNC or polls."""
        s, wires = self.row.record, self.wires
        until_ns = int(s["tick"]) * self.period_ns if first else int(wires.record["synced_ns"])
        received = wires.commands[: s["early"] if first else wires.record["commands"]]
        if s["nodes"]:
            replies = self.nodes.go_on(received, stopped)
        elif first:
            replies = self.nodes.advance(until_ns, received)
        else:
            deadline_ns = int(s["tick"]) * self.period_ns + int(s["window_ns"])
            replies = self.nodes.answer(until_ns, received, self.wires.wanted, deadline_ns)
        self._replies = replies
        s["replies"], s["replied"] = data_at(replies), len(replies)
        self._look_at_nodes()
        s["stage"] += 1

    def _report_mode(self) -> None:
        """Notify faults that wait for a mode of the controller when it is reached."""
        cycle = self.cycle
        mode = cycle.mode
        if mode is not self._mode:
            self._mode = mode
            self.nodes.reached(mode.name)
        resting = mode is Mode.TRACKING and not cycle.tick["dq_d"].any()
        self._rests = self._rests + 1 if resting else 0
        if self._rests == round(REST_S * cycle.parts.rate_Hz):
            self.nodes.reached("HOLD")

    def run(
        self,
        duration_s: float | None,
        observe: Observer | None,
        event: EventSink = no_event,
        commands: Callable[[int], Given] = lambda _: NOTHING,
        *,
        take: Taker | None = None,
        silent: Callable[[int], float] = lambda _: inf,
        armed: bool = True,
        over: Callable[[], bool] = lambda: False,
        answered: Callable[[Sequence[str], Sequence[str], Sequence[str]], None] = lambda *_: None,
    ) -> Ending:
        """Simulate a whole run: engage, follow the reference, park; return the end of the run.

        commands: operator input of a tick. answered: called afterwards with the reasons of refusal, empty for
        accepted commands. armed: engage without a command. over: True when the operator has no more commands.
        event: called with the fault events of each tick. The run also ends with its plant.

        Without `observe`, `take` gets many ticks at once, computed without Python in between. silent: number
        of ticks from the given one on without commands.
        """
        stays = self.cycle.parts.operator.stays
        course = Course(self.cycle, duration_s, event=event, armed=armed, goes_on=stays)
        ending, held, most = None, False, 1
        while ending is None:
            tick = self.tick + 1
            said = commands(tick)
            taken, mode, refused = said.operator, self.cycle.mode, list[str]()
            was_held, held = held, mode is Mode.HELD
            if taken:
                goes_on = course.goes_on
                refused = [refusal(each, mode, was_held=was_held, goes_on=goes_on) for each in taken]
                taken = tuple(each for each, why in zip(taken, refused, strict=True) if not why)
            elif over() and not said.orders:
                taken = course.left_alone()
            given = said._replace(operator=course.commands(tick, taken))
            try:
                if observe is not None:
                    observe(*self.step(given.operator, given.setpoints, given.orders))
                else:
                    alone = any(given) or self.nodes.waiting
                    count = 1 if alone else int(min(course.quiet(tick), silent(tick), most))
                    begun_s = perf_counter()
                    self.row.new = slice(0, 0)
                    try:
                        self.advance(count, given)
                    finally:
                        if take is not None and self.row.new.start < self.row.new.stop:
                            take(self.row.ticks, self.row.new, given)
                    soon = perf_counter() - begun_s < LONGEST_S
                    most = min(2 * most, CAPACITY) if soon else max(most // 2, 1)
            except PlantError as error:
                return course.failed(str(error), self.tick)
            if any(said):
                setpoints = setpoint_refusals(self.cycle, len(said.setpoints))
                answered(refused, self.cycle.operating.answers, setpoints)
            ending = course.ending(self.tick)
        return ending
