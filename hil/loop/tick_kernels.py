"""The controller's part of ticks that pass one after the other, compiled, for kernels of both ends.

A tick goes through stages, from START to COMMAND. It stops where there is something for Python to do
(`hil.loop.tick_row.TickRow`), and is entered again at that stage or at the next.
"""

from typing import Any

from drivers.compiled.compiler import helper, record
from drivers.compiled.pointed import call, integers_at, record_at
from drivers.controller_end import MOST_FRAMES
from drivers.frame_array import FRAME, SENT
from drivers.frame_pointers import frame_at, frames_at
from drivers.tick_columns import TICK
from hil.loop import compiled_pass
from hil.loop.compiled_pass import ALL, CONTROL

START, OBSERVE, ACT, COMMAND = 0, 6, 7, 8
"""Stages: the controller says what starts the tick; it decodes and estimates; its law acts; its command is
sent. Those of a bus lie between the first two."""
NO_ROOM, ATTENDED = -1, -2
"""Why OBSERVE stops, besides what `compiled_pass.observe` returns: there is no room for the frames; Python
attends to the tick. ACT stops with what `compiled_pass.act` returns."""
ROW_OF_TICKS = [
    (name, "<i8")
    for name in (
        *("control", "opening", "opener", "begun", "starts", "begins"),
        *("ticks", "last", "frames", "room", "used", "ends", "count", "done"),
        *("stage", "attends", "heard_at", "heard", "sent"),
    )
]
"""Fields of a kernel's record. Addresses: the record of CONTROL; how a tick starts, `ControllerEnd.opening`;
the record that each tick begins as; scratch for the frames that start a tick, and how many they are.

Of the row of ticks: records of TICK; that of the tick before; FRAME elements, of each tick those heard, those
that started it and those of its command, their room and how many there are; where each of these three ends,
(ticks, 3); up to which tick to go, and how many are done. The stage; whether Python attends to the tick; the
frames that the controller hears in it; how many its command has.
"""
BYTES = FRAME.itemsize
_WORDS, _TICK_BYTES = BYTES // 8, TICK.itemsize
tick_at = record_at(record(TICK))
_control_at = record_at(record(CONTROL))


@helper
def start(s: Any, number: int) -> int:
    """Let the controller say what starts a tick; return 0."""
    s.begins = call(s.opening, (s.opener, number, s.starts))
    return 0


@helper
def _keep(s: Any, source: int, count: int) -> None:
    words = count * _WORDS
    integers_at(s.frames + s.used * BYTES, words)[:] = integers_at(source, words)
    s.used += count


@helper
def begin_tick(s: Any) -> Any:
    """Return the record of the tick, begun; 0 columns of it are the input's."""
    place, words = s.ticks + s.done * _TICK_BYTES, _TICK_BYTES // 8
    integers_at(place, words)[:] = integers_at(s.begun, words)
    return tick_at(place)


@helper
def has_room(s: Any) -> bool:
    """Tell whether the frames of a tick have room."""
    return bool(s.used + s.heard + 2 * MOST_FRAMES <= s.room)


@helper
def observe(s: Any, tick: Any) -> int:
    """Let the controller hear `heard` frames at `heard_at`; return 0, or why it stops."""
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
    """Let the controller's law act; return 0, or why it stops."""
    control, into = _control_at(s.control), frames_at(s.frames + s.used * BYTES, MOST_FRAMES)
    ended = int(compiled_pass.act(control, tick_at(s.ticks + s.done * _TICK_BYTES), into, ALL))
    s.sent = control.sent
    return ended


@helper
def end_tick(s: Any) -> None:
    """End the tick: what it sent was sent at its instant."""
    ends = integers_at(s.ends + s.done * 24, 3)
    s.last = s.ticks + s.done * _TICK_BYTES
    t_ns = tick_at(s.last).t_ns
    s.used += s.sent
    ends[2] = s.used
    for k in range(ends[0], s.used):
        frame = frame_at(s.frames + k * BYTES)
        frame.t_ns, frame.kind = t_ns, SENT
    s.done += 1
