"""Many ticks in one compiled call, which returns where the cycle has something to decide in Python.

The controller's part of a tick is compiled, for kernels with and without a plant. A tick runs through stages,
from START to COMMAND. The call returns where Python has to act (`TickRow`); the next call continues at that
stage or after it.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from drivers.arrays import Ints, Rows
from drivers.compiled.compiler import helper, record
from drivers.compiled.pointed import call, data_at, integers_at, record_at
from drivers.controller_end import MOST_FRAMES
from drivers.frame_array import FRAME, SENT
from drivers.frame_pointers import frame_at, frames_at
from drivers.tick_columns import ROW, TICK, Record, new_record
from hil.loop import compiled_pass
from hil.loop.compiled_pass import ALL, CONTROL
from hil.loop.cycle import Cycle
from hil.loop.tick_input import input_of, put_input
from hil.signals import Operator, Order, SetPoint, TickInput

START, OBSERVE, ACT, COMMAND = 0, 6, 7, 8
"""Stages: the controller gives the frames that start the tick; it decodes and estimates; its law acts; its
command is sent. The stages of a bus lie between the first two."""
NO_ROOM, ATTENDED = -1, -2
"""Further reasons for a stop in OBSERVE, besides the results of `compiled_pass.observe`: no room for the
frames; Python takes part in the tick. ACT stops with a result of `compiled_pass.act`."""
ROW_OF_TICKS = [
    (name, "<i8")
    for name in (
        *("control", "opening", "opener", "begun", "starts", "begins"),
        *("ticks", "last", "frames", "room", "used", "ends", "count", "done"),
        *("stage", "attends", "heard_at", "heard", "sent"),
    )
]
"""Fields of a kernel's record. Addresses: the record of CONTROL; `ControllerEnd.opening` and its context; the
initial record of each tick; a buffer for the frames that start a tick, and their number.

Of the row of ticks: records of TICK; the record of the last tick; FRAME elements, per tick those received,
those that started it and those of its command, with capacity and number; the ends of these three, (ticks, 3);
the tick count to reach, and the ticks done. Also: the stage; whether Python takes part in the tick; address
and number of the received frames; number of frames of the command."""
BYTES = FRAME.itemsize
_WORDS, _TICK_BYTES = BYTES // 8, TICK.itemsize
tick_at = record_at(record(TICK))
_control_at = record_at(record(CONTROL))


@helper
def start(s: Any, number: int) -> int:
    """Copy the controller's first frames of tick `number` (SYNC or polls) to the frames; returns 0."""
    s.begins = call(s.opening, (s.opener, number, s.starts))
    return 0


@helper
def _keep(s: Any, source: int, count: int) -> None:
    words = count * _WORDS
    integers_at(s.frames + s.used * BYTES, words)[:] = integers_at(source, words)
    s.used += count


@helper
def begin_tick(s: Any) -> Any:
    """Record of the present tick with initial values; its input columns are not filled in yet."""
    place, words = s.ticks + s.done * _TICK_BYTES, _TICK_BYTES // 8
    integers_at(place, words)[:] = integers_at(s.begun, words)
    return tick_at(place)


@helper
def has_room(s: Any) -> bool:
    """True if the array of frames has room for the frames of one more tick."""
    return bool(s.used + s.heard + 2 * MOST_FRAMES <= s.room)


@helper
def observe(s: Any, tick: Any) -> int:
    """Run the observe stage of a tick on its received frames; returns 0, or why Python has to act."""
    ends = integers_at(s.ends + s.done * 24, 3)
    at = s.frames + s.used * BYTES
    _keep(s, s.heard_at, s.heard)
    ends[0] = s.used
    _keep(s, s.starts, s.begins)
    ends[1] = s.used
    look = int(compiled_pass.observe(_control_at(s.control), tick, tick_at(s.last), frames_at(at, s.heard)))
    return ATTENDED if look == 0 and s.attends != 0 else look


@helper
def act(s: Any) -> int:
    """Run law, safety and command of the tick; returns 0, or the reason to return to Python."""
    control, into = _control_at(s.control), frames_at(s.frames + s.used * BYTES, MOST_FRAMES)
    ended = int(compiled_pass.act(control, tick_at(s.ticks + s.done * _TICK_BYTES), into, ALL))
    s.sent = control.sent
    return ended


@helper
def end_tick(s: Any) -> None:
    """Finish the tick: store its sent frames, stamped with its start time."""
    ends = integers_at(s.ends + s.done * 24, 3)
    s.last = s.ticks + s.done * _TICK_BYTES
    t_ns = tick_at(s.last).t_ns
    s.used += s.sent
    ends[2] = s.used
    for k in range(ends[0], s.used):
        frame = frame_at(s.frames + k * BYTES)
        frame.t_ns, frame.kind = t_ns, SENT
    s.done += 1


CAPACITY = 64
"""Number of ticks held in memory."""
_FRAMES_A_TICK = 24


class Given(NamedTuple):
    """The operator's input in a tick: commands, orders and set-points."""

    operator: tuple[Operator, ...] = ()
    orders: tuple[Order, ...] = ()
    setpoints: tuple[SetPoint, ...] = ()


NOTHING = Given()


class Ticks:
    """Memory for CAPACITY ticks, which the kernel fills in order; no tick is filled twice.

    Attributes: records (CAPACITY, words of TICK); frames, FRAME records: of each tick the received ones,
    those that started it and those of its command, sent at its instant; ends (CAPACITY, 3), the ends of
    these.
    """

    def __init__(self) -> None:
        self.records = np.empty((CAPACITY, TICK.itemsize // 8))
        self.ends = np.zeros((CAPACITY, 3), np.int64)
        self.frames: Rows = np.empty(CAPACITY * _FRAMES_A_TICK + 2 * MOST_FRAMES, FRAME)

    def record(self, k: int) -> Record:
        """Record of tick k."""
        return np.ndarray((), TICK, self.records[k])

    def row(self, k: int) -> Record:
        """Recorded columns of tick k."""
        return np.ndarray((), ROW, self.records[k])

    def recorded(self, ticks: slice) -> tuple[Rows, Rows, Ints]:
        """Rows and frames of some ticks, and (n,) the number of frames up to the end of each tick."""
        records = self.records[ticks]
        rows = np.ndarray((len(records),), ROW, records, strides=(TICK.itemsize,))
        first = int(self.ends[ticks.start - 1, 2]) if ticks.start else 0
        ends = self.ends[ticks, 2]
        return rows, self.frames[first : int(ends[-1])], ends - first

    def spans(self, k: int) -> tuple[slice, slice, slice]:
        """Slices of `frames` for a tick: received frames, frames that started it, frames of its command."""
        first = int(self.ends[k - 1, 2]) if k else 0
        heard, opened, ended = self.ends[k].tolist()
        return slice(first, heard), slice(heard, opened), slice(opened, ended)


class TickRow:
    """Runs the ticks of a cycle in order, many in one compiled call where nothing is to be decided.

    Mutable state: the kernel's record, the ticks that it fills, the operator's input, and the cycle itself.
    """

    def __init__(
        self,
        cycle: Cycle,
        dtype: np.dtype[np.void],
        kernel: Callable[[Record], int],
        attend: Callable[[int, int], None] | None = None,
    ) -> None:
        """kernel: works on a record of `dtype`, which begins with ROW_OF_TICKS.

        attend: called with stage and reason when the kernel returns in a stage that is not the controller's.
        """
        self._cycle, self._kernel, self._attend = cycle, kernel, attend
        self.record = s = np.zeros((), dtype)
        self._begun, self._starts = new_record(), np.zeros(MOST_FRAMES, FRAME)
        put_input(self._begun, TickInput(0, 0))
        s["control"] = data_at(cycle.control.record)
        s["opening"], s["opener"] = cycle.opening.address, cycle.opening.context
        s["begun"], s["starts"] = data_at(self._begun), data_at(self._starts)
        self._given, self._decided = NOTHING, False
        self.new: slice[int, int, None] = slice(0, 0)
        """The ticks that the last `go` has done."""
        self._turn_over()

    def go(self, count: int, given: Given = NOTHING) -> slice:
        """Run at most `count` ticks; ends earlier when `ticks` is full, or after a tick with a decision.

        given: the operator's input of the first tick. Returns the ticks done; after an exception, see `new`.
        """
        s, cycle = self.record, self._cycle
        if s["done"] == CAPACITY:
            self._turn_over()
        before, first = cycle.tick, int(s["done"])
        self.new = slice(first, first)
        s["last"] = data_at(before)
        self._given, self._decided = given, False
        s["attends"] = any(given) or cycle.control.probes
        s["count"] = min(first + count, CAPACITY)
        try:
            while stopped := self._kernel(self.record):
                self._stop(int(s["stage"]), stopped)
        finally:
            done = int(s["done"])
            self.new = slice(first, done)
            if done > first and not self._decided:
                last = self.ticks.record(done - 2) if done > first + 1 else before
                cycle.pass_on(last, self.ticks.record(done - 1))
        return self.new

    def _turn_over(self) -> None:
        s, self.ticks, self.new = self.record, Ticks(), slice(0, 0)
        s["ticks"], s["ends"] = data_at(self.ticks.records), data_at(self.ticks.ends)
        s["done"] = s["used"] = 0
        self._hold(self.ticks.frames)

    def _hold(self, frames: Rows) -> None:
        self.ticks.frames = frames
        self.record["frames"], self.record["room"] = data_at(frames), len(frames)

    def _stop(self, stage: int, stopped: int) -> None:
        """Handle a return of the kernel in a stage: get room for frames, or let Python act."""
        if stage == OBSERVE and stopped == NO_ROOM:
            frames = self.ticks.frames
            self._hold(np.concatenate((frames, np.empty(self.record["heard"] + len(frames), FRAME))))
        elif stage in (OBSERVE, ACT):
            self._decide(stopped, observed=stage == OBSERVE)
        else:
            assert self._attend is not None
            self._attend(stage, stopped)

    def _decide(self, stopped: int, *, observed: bool) -> None:
        """Let the cycle decide in the present tick, which becomes the last one of `go`."""
        s, ticks, cycle, given = self.record, self.ticks, self._cycle, self._given
        k, used = int(s["done"]), int(s["used"])
        tick = ticks.record(k)
        cycle.pass_on(ticks.record(k - 1) if k > self.new.start else cycle.tick, tick)
        self._decided, s["count"] = True, k + 1
        heard = ticks.frames[used - s["begins"] - s["heard"] : used - s["begins"]]
        inp = input_of(ticks.row(k), heard, given.operator, given.setpoints, given.orders)
        into = ticks.frames[used : used + MOST_FRAMES]
        frames = cycle.decide(inp, into, max(stopped, 0)) if observed else cycle.end_tick(inp, into, stopped)
        into[: len(frames)] = frames
        s["sent"], s["stage"] = len(frames), COMMAND
