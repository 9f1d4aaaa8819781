"""Compiled bus traffic of one simulated tick: SYNC or polls, answers, commands.

Each bus has its own arbitration and bit time. A frame takes its worst-case bit time, and the lowest
identifier wins arbitration.
"""

from typing import Any

import numpy as np

from drivers.arrays import Ints
from drivers.can.arbitration import (
    DURATION_NS,
    FOREVER,
    NUMBER,
    PRIORITY,
    QUEUED_NS,
    WIRE,
    priority,
    transmit,
)
from drivers.can.arbitration import SENT as GONE
from drivers.compiled.compiler import INTEGER, helper, kernel, record, records
from drivers.compiled.pointed import address_of, call, integers_at
from drivers.frame_array import FRAME, RECEIVED
from drivers.frame_pointers import frame_at
from drivers.protocol import ALWAYS
from drivers.signals import LEGS

LENGTHS, FLAGS = 65, 64
FROM_DRIVE, CONTENT = WIRE + 1, WIRE + 2
"""Columns of a row of the queue after those of `arbitration`: 1 for a drive's frame; the frame's words."""
_FRAME = FRAME.itemsize
_WORDS = _FRAME // 8
ROW = CONTENT + _WORDS
DONE, FULL, UNFIT = range(3)
"""Status: done; nothing done for lack of room; a frame that the bus cannot carry."""
WIRES = np.dtype(
    [
        *((name, "<i8") for name in ("buses", "room", "number", "free", "times")),
        *((name, "<i8") for name in ("queue", "waiting", "commands_at", "commands", "late_at", "late")),
        *((name, "<i8") for name in ("taken", "step_ns", "synced_ns", "skew_ns")),
        *((name, "<i8") for name in ("fresh", "addressed", "tables", "wanted_at", "wanted", "missing_at")),
        ("latch_ns", "<i8", (LEGS,)),
    ]
)
"""The buses between both ends.

Addresses: `free`, when each bus falls free (buses,) ns; `times`, duration of a frame by bus, length and flags
(buses, LENGTHS, FLAGS) ns; `queue` (room, ROW), with `waiting` rows in use; `commands_at`, FRAME elements for
the drives since their last step; `late_at`, FRAME elements for the controller after its window.
Of the last tick: `taken`, how many of the latter the controller takes, and `step_ns`, when; `synced_ns`, end
of its SYNC or polls; `skew_ns`, from that on the first bus to that on the last; `latch_ns`, from the begin of
the tick to each leg's. Of the controller's `Family`: its functions, tables, wanted identifiers, and scratch.
"""


@helper
def _queue_of(w: Any) -> Ints:
    return integers_at(w.queue, w.room * ROW).reshape((w.room, ROW))


@helper
def _copy(source: int, into: int) -> None:
    integers_at(into, _WORDS)[:] = integers_at(source, _WORDS)


@helper
def _same(a: Any, b: Any) -> bool:
    """True if two frames are equal except for their times."""
    if a.id != b.id or a.length != b.length or a.flags != b.flags or a.bus != b.bus:
        return False
    return bool((a.data[: a.length] == b.data[: b.length]).all())


@helper
def _duration(w: Any, frame: Any) -> int:
    """Duration of a frame on its bus, ns; < 0: the bus cannot carry the frame."""
    if frame.bus >= w.buses:
        return -1
    times = integers_at(w.times, w.buses * LENGTHS * FLAGS)
    return int(times[(frame.bus * LENGTHS + frame.length) * FLAGS + frame.flags])


@helper
def _total(w: Any, frames: Any) -> int:
    total = 0
    for k in range(frames.shape[0]):
        total += _duration(w, frames[k])
    return total


@helper
def _put(w: Any, frames: Any, t_ns: int, from_drive: int) -> int:
    """Put frames into their nodes' transmit queues, each at its own instant, but not before `t_ns`."""
    count = frames.shape[0]
    if w.waiting + max(w.commands, w.late) + count > w.room:
        return FULL
    for k in range(count):
        if _duration(w, frames[k]) < 0:
            return UNFIT
    queue = _queue_of(w)
    for k in range(count):
        frame, row = frames[k], queue[w.waiting]
        w.number += 1
        row[QUEUED_NS] = max(frame.t_ns, t_ns)
        row[PRIORITY], row[NUMBER] = priority(int(frame.id), int(frame.flags)), w.number
        row[DURATION_NS], row[WIRE], row[FROM_DRIVE] = _duration(w, frame), frame.bus, from_drive
        _copy(address_of(frame), row[CONTENT:].ctypes.data)
        w.waiting += 1
    return DONE


@helper
def _deliver(w: Any, row: Ints, end_ns: int, first: int) -> None:
    """Deliver a frame to its receiver in the order of time, after element `first` of the late frames."""
    if row[FROM_DRIVE]:
        frames, place = w.late_at, w.late
        w.late += 1
    else:
        frames, place, first = w.commands_at, w.commands, 0
        w.commands += 1
    into = frames + place * _FRAME
    while place > first and frame_at(into - _FRAME).t_ns > end_ns:
        _copy(into - _FRAME, into)
        place -= 1
        into -= _FRAME
    _copy(row[CONTENT:].ctypes.data, into)
    frame = frame_at(into)
    frame.t_ns, frame.kind = end_ns, RECEIVED


@helper
def _carry(w: Any, until_ns: int) -> None:
    """Deliver every frame whose transmission starts by `until_ns`."""
    queue, free, first = _queue_of(w), integers_at(w.free, w.buses), w.late
    for bus in range(w.buses):
        while True:
            row, end_ns = transmit(queue, w.waiting, bus, free[bus], until_ns)
            if row < 0:
                break
            queue[row, WIRE], free[bus] = GONE, end_ns
            _deliver(w, queue[row], end_ns, first)
    left = 0
    for k in range(w.waiting):
        if queue[k, WIRE] != GONE:
            queue[left] = queue[k]
            left += 1
    w.waiting = left


@helper
def _waits(w: Any, bus: int, opening: Any) -> bool:
    """True if a frame that starts the tick still waits for transmission on a bus."""
    queue = _queue_of(w)
    for k in range(w.waiting):
        if queue[k, WIRE] == bus:
            waiting = frame_at(queue[k, CONTENT:].ctypes.data)
            for n in range(opening.shape[0]):
                if _same(waiting, opening[n]):
                    return True
    return False


@helper
def _sent_ns(w: Any, frame: Any, t_ns: int) -> int:
    """End, ns, of the last frame equal to `frame` since t_ns; FOREVER: no such frame."""
    for k in range(w.commands - 1, -1, -1):
        heard = frame_at(w.commands_at + k * _FRAME)
        if heard.t_ns >= t_ns and _same(heard, frame):
            return int(heard.t_ns)
    return FOREVER


@helper
def _note_sent(w: Any, t_ns: int, opening: Any) -> None:
    """Store when the frames that start the tick ended, for each leg, and the skew between the buses."""
    w.latch_ns[:] = 0
    soonest = np.full(w.buses, ALWAYS)
    for n in range(opening.shape[0]):
        frame = opening[n]
        if soonest[frame.bus] == ALWAYS:
            soonest[frame.bus] = FOREVER
        sent_ns = _sent_ns(w, frame, t_ns)
        if sent_ns == FOREVER:
            continue
        soonest[frame.bus] = min(soonest[frame.bus], sent_ns)
        legs = call(w.addressed, (w.tables, address_of(frame)))
        for leg in range(LEGS):
            if legs >> leg & 1:
                w.latch_ns[leg] = sent_ns - t_ns
    first = FOREVER
    for bus in range(w.buses):
        if soonest[bus] != ALWAYS:
            first = min(first, soonest[bus])
    w.skew_ns = 0 if soonest.max() in (FOREVER, ALWAYS) else soonest.max() - first


@kernel(record(WIRES), records(FRAME), INTEGER, INTEGER)
def begin(w: Any, opening: Any, t_ns: int, deadline_ns: int) -> int:
    """Deliver the frames that start the tick (SYNC or polls) to the drives, and store their end time."""
    status = _put(w, opening, t_ns, 0)
    if status != DONE:
        return status
    free, until_ns = integers_at(w.free, w.buses), t_ns
    for k in range(opening.shape[0]):
        until_ns = max(until_ns, opening[k].t_ns)
    _carry(w, until_ns)
    for bus in range(w.buses):
        # it waits for the frame on the wire; on an overloaded bus until the deadline
        while free[bus] <= deadline_ns and _waits(w, bus, opening):
            _carry(w, free[bus])
    _note_sent(w, t_ns, opening)
    last = frame_at(w.commands_at + (w.commands - 1) * _FRAME).t_ns if w.commands else t_ns
    w.synced_ns = max(last, t_ns)
    return DONE


@kernel(record(WIRES), INTEGER)
def heard_by(w: Any, t_ns: int) -> int:
    """Number of frames for the drives that ended by t_ns; these come first in the array."""
    count = 0
    while count < w.commands and frame_at(w.commands_at + count * _FRAME).t_ns <= t_ns:
        count += 1
    return count


@kernel(record(WIRES), records(FRAME), INTEGER, INTEGER)
def pass_on(w: Any, replies: Any, until_ns: int, heard: int) -> int:
    """Drop the first `heard` frames for the drives, and queue the drives' frames at their own instants."""
    status = _put(w, replies, ALWAYS, 1)
    if status != DONE:
        return status
    words = integers_at(w.commands_at, w.commands * _FRAME // 8)
    for k in range(heard * _FRAME // 8, words.size):
        words[k - heard * _FRAME // 8] = words[k]
    w.commands -= heard
    _carry(w, until_ns)
    return DONE


@helper
def _at_once(w: Any, replies: Any, deadline_ns: int) -> bool:
    """True if all frames are queued at one instant on one idle bus, and end by the deadline."""
    if w.buses > 1 or w.waiting or replies.shape[0] == 0:
        return False
    first, last = replies[0].t_ns, replies[replies.shape[0] - 1].t_ns
    end_ns = max(first, integers_at(w.free, 1)[0]) + _total(w, replies)
    return bool(first == last and end_ns <= deadline_ns)


@helper
def _is_fresh(w: Any, at: int, tick: int, t_ns: int) -> int:
    return int(call(w.fresh, (w.tables, at, tick, t_ns)))


@helper
def _last_wanted(w: Any, early: int) -> int:
    """Number of answers received when the last wanted identifier has arrived; 0 if one is missing."""
    wanted, missing = integers_at(w.wanted_at, w.wanted), integers_at(w.missing_at, w.wanted)
    missing[:] = 1
    left = w.wanted
    for n in range(early, w.late):
        identifier = np.int64(frame_at(w.late_at + n * _FRAME).id)
        for k in range(w.wanted):
            if missing[k] and wanted[k] == identifier:
                missing[k] = 0
                left -= 1
                if left == 0:
                    return n - early + 1
    return 0


@helper
def _take(w: Any, early: int, tick: int, t_ns: int, deadline_ns: int) -> None:
    """Take the answers up to the one that completes the feedback, or up to the deadline."""
    missing = integers_at(w.missing_at, w.wanted)
    missing[:] = 1
    left = w.wanted
    for n in range(early, w.late):
        at = w.late_at + n * _FRAME
        end_ns = frame_at(at).t_ns
        place = _is_fresh(w, at, tick, t_ns)
        if 0 < place <= w.wanted and missing[place - 1]:
            missing[place - 1] = 0
            left -= 1
        if end_ns > deadline_ns or left == 0:
            w.taken = n if end_ns > deadline_ns else n + 1
            w.step_ns = min(end_ns, deadline_ns)
            return


@kernel(record(WIRES), records(FRAME), INTEGER, INTEGER, INTEGER)
def answer(w: Any, replies: Any, tick: int, t_ns: int, deadline_ns: int) -> int:
    """Deliver the drives' answers to the controller; store how many it takes in this tick, and when."""
    w.commands, early = 0, w.late
    together = _at_once(w, replies, deadline_ns)
    status = _put(w, replies, ALWAYS, 1)
    if status != DONE:
        return status
    if w.wanted == 0:  # the drives send by their timer, and the controller does not wait
        w.taken, w.step_ns = early, t_ns
        while w.taken > 0 and frame_at(w.late_at + (w.taken - 1) * _FRAME).t_ns > t_ns:
            w.taken -= 1
        return DONE
    _carry(w, deadline_ns)
    w.taken, w.step_ns = w.late, deadline_ns
    if not together:
        _take(w, early, tick, t_ns, deadline_ns)
        return DONE
    # queued at one instant, they answer the same frame: all are fresh if one is
    complete = _last_wanted(w, early)
    last = w.late_at + (early + complete - 1) * _FRAME
    if complete and _is_fresh(w, last, tick, t_ns):
        w.taken, w.step_ns = early + complete, frame_at(last).t_ns
    return DONE


@kernel(record(WIRES), records(FRAME), INTEGER, INTEGER)
def command(w: Any, frames: Any, t_ns: int, until_ns: int) -> int:
    """Queue the controller's command frames, and drop the feedback frames that it has taken.

    On a single idle bus they are transmitted at once if they end by `until_ns`, as no other frame is queued
    before.
    """
    for k in range(w.taken, w.late):
        _copy(w.late_at + k * _FRAME, w.late_at + (k - w.taken) * _FRAME)
    w.late -= w.taken
    w.taken = 0
    alone = w.buses == 1 and w.waiting == 0
    status = _put(w, frames, t_ns, 0)
    if status == DONE and alone and max(t_ns, integers_at(w.free, 1)[0]) + _total(w, frames) <= until_ns:
        _carry(w, until_ns)
    return status
