"""One compiled call, `live`, that advances six drives and their plant to an instant.

The call does the work of every tick. It returns early, with the reason, for a decision or a part that is not
compiled. The caller does that and calls it again.
"""

from typing import Any

import numpy as np

from drivers.arrays import Array
from drivers.cia402 import objects as o
from drivers.compiled.compiler import BOOLEAN, INTEGER, helper, kernel, record, records
from drivers.compiled.pointed import call, integers_at
from drivers.frame_array import FRAME, SENT
from drivers.frame_pointers import begin_sent, frame_at, in_order
from drivers.signals import LEGS, DriveFault
from drivers.transmission import fill_loss
from plant_fmu.drives import codec
from plant_fmu.drives import record as r
from plant_fmu.drives.drive_rules import (
    NEVER_NS,
    actuate,
    configure,
    encoders,
    fail,
    feed,
    next_move_ns,
    obey,
    tripped,
)

NODES_RECORD: Any = record(r.NODES)
_FRAME, _MESSAGE = FRAME.itemsize, codec.MESSAGE.itemsize
_FRAME_WORDS, _MESSAGE_WORDS, _READING_WORDS = _FRAME // 8, _MESSAGE // 8, codec.READING.itemsize // 8
_WATCHDOG, _ESTOP = int(DriveFault.WATCHDOG), int(DriveFault.ESTOP)


@helper
def _grid_ns(n: Any) -> int:
    return int(n.t0_ns + np.int64(np.rint(n.k * n.h_ns)))


@helper
def due_ns(t0_ns: int, number: int, share: float) -> int:
    """Instant, ns, of event `number` in a series with period `share` ns; NEVER_NS if the period is 0."""
    return t0_ns + int(np.int64(np.rint(number * share))) if share > 0.0 else NEVER_NS


# the plant


@helper
def _at_leg(n: Any, into: Array) -> None:
    """Fill in leg forces, N: the drives' forces divided by the loss factor of the transmission."""
    if n.geared:
        fill_loss(n.force, n.rate, n.driving, n.back_driving, n.full_loss_m_s, into)
        for leg in range(LEGS):
            into[leg] = n.force[leg] / into[leg]
    else:
        into[:] = n.force


@helper
def _move(n: Any, steps: int) -> int:
    _at_leg(n, n.at_leg)
    measured, n.steps = n.measured, steps
    force, brake, wrench = n.at_leg.ctypes.data, n.brake.ctypes.data, n.wrench.ctypes.data
    n.refusal = call(n.move, (n.plant, force, brake, wrench, steps, measured.ctypes.data))
    if n.refusal != 0:
        return r.PLANT
    n.length[:] = measured[0]
    n.rate[:] = measured[1]
    if n.not_finite:
        n.length[:] = np.nan
    n.k += steps
    return r.DONE


@helper
def move_to(n: Any, t_ns: int) -> int:
    """Advance the plant to its time step nearest to `t_ns`; returns DONE or the plant's refusal."""
    steps = np.int64(np.floor((t_ns - n.t0_ns) / n.h_ns + 0.5)) - n.k
    if steps <= 0:
        return r.DONE
    if not n.lags and not n.controls:
        return _move(n, steps)
    for _ in range(steps):
        actuate(n, n.lags != 0, _grid_ns(n))
        status = _move(n, 1)
        if status != r.DONE:
            return status
    return r.DONE


# time


@helper
def _to_report(n: Any, leg: int) -> None:
    if n.reported == n.pending:
        n.pending = n.reported = n.due = 0
    n.reports[n.pending] = leg
    n.pending += 1


@helper
def _fail(n: Any, legs: Any, fault: int) -> int:
    status = move_to(n, n.t_ns)
    for leg in legs:
        if status == r.DONE and fail(n, leg, fault, n.t_ns):
            _to_report(n, leg)
    return status


@helper
def _happen(n: Any, t_ns: int) -> int:
    """Execute the earliest event due by `t_ns`; without one, store when the next is due."""
    watchdog, moved = n.deadline_ns.min(), next_move_ns(n)
    other = min(n.edge_ns, n.beat_ns, n.reading_ns, moved)
    if watchdog < t_ns and watchdog <= other:
        n.t_ns, n.now_ns = watchdog, max(n.now_ns, watchdog)
        return _fail(n, tripped(n, watchdog), _WATCHDOG)
    if other > t_ns:
        n.calm_ns = min(max(watchdog, t_ns + 1), other)
    elif other in (moved, n.edge_ns):
        status = move_to(n, other)
        if status != r.DONE:
            return status
        if moved != other:
            n.t_ns, n.now_ns = other, max(n.now_ns, other)
            return r.EDGE
        actuate(n, False, moved)
    elif n.beat_ns == other:
        n.reports[0], n.reported, n.pending, n.due, n.t_ns = n.beat % LEGS, 0, 1, 1, other
        n.beat += 1
        n.beat_ns = due_ns(n.t0_ns, n.beat, n.beat_share)
    else:
        asked = codec.message_at(n.asked)
        asked.kind, asked.counter, asked.count, asked.legs[0] = codec.SYNC, 0, 1, n.spoken % LEGS
        n.spoken += 1
        n.reading_ns = due_ns(n.t0_ns, n.spoken + 1, n.reading_share)
        n.t_ns, n.latching = other, 1
    return r.DONE


@helper
def _pass_time(n: Any, frames: int, count: int) -> int:
    """Execute the events before the next frame, or receive that frame."""
    t_ns, is_end = n.until_ns, n.frame == count
    if not is_end:
        t_ns = min(max(frame_at(frames + n.frame * _FRAME).t_ns, n.now_ns), t_ns)
    if t_ns >= n.calm_ns:
        return _happen(n, t_ns)
    n.now_ns = n.t_ns = t_ns
    n.frame += 1
    if is_end:
        return move_to(n, t_ns)
    n.message = 0
    n.heard = call(n.parse, (n.end, frames + (n.frame - 1) * _FRAME, n.messages))
    return r.PARSE if n.heard < 0 else r.DONE


# frames


@helper
def _put(n: Any, count: int, leg: int) -> None:
    """Send `count` new frames of drive `leg` (-1: of the drives in `senders`), except silent drives."""
    senders = integers_at(n.senders, r.ROOM)
    first = n.sent
    for k in range(first, first + count):
        sender = senders[k - first] if leg < 0 else leg
        if n.silent >> sender & 1:
            continue
        if k != n.sent:
            source = integers_at(n.out + k * _FRAME, _FRAME_WORDS)
            integers_at(n.out + n.sent * _FRAME, _FRAME_WORDS)[:] = source
        frame = frame_at(n.out + n.sent * _FRAME)
        frame.t_ns, frame.kind = n.t_ns, SENT
        n.sent += 1


@helper
def _report(n: Any) -> None:
    leg = n.reports[n.reported]
    number, into, count = n.number[leg], n.out + n.sent * _FRAME, 0
    if number != r.MUTE:
        watchdog = n.watchdog_ns[leg] if n.configured[leg] else -1
        state, fault, reaction = n.state[leg], n.fault[leg], n.reaction[leg]
        count = call(n.report, (n.end, number, state, fault, watchdog, reaction, n.due, into))
    elif n.strange[leg]:
        begin_sent(frame_at(into), n.strange[leg], 1, 0, 0)
        frame_at(into).data[0] = o.PREPARES
        count = 1
    _put(n, count, leg)
    n.reported += 1


@helper
def _read(n: Any) -> None:
    """Read forces and encoders, extrapolated from the plant's time step to the present instant."""
    reading = codec.reading_at(n.reading)
    reading.force[:] = n.measured[2]
    if np.isnan(reading.force[0]):
        _at_leg(n, reading.force)
    dt_s = (n.t_ns - _grid_ns(n)) * 1e-9
    encoders(n, dt_s, reading.length, reading.rate, reading.state)
    reading.fault[:] = n.fault


@helper
def _answers(n: Any) -> int:
    """Write the drives' answers to a SYNC message; returns their number, FAILED for a NaN reading."""
    into = n.out + n.sent * _FRAME
    if not n.wired:
        return int(call(n.answer, (n.end, n.asked, n.reading, into, n.senders)))
    asked, reading, senders = codec.message_at(n.asked), integers_at(n.reading, _READING_WORDS), n.senders
    legs, true, total = asked.legs[: asked.count].copy(), reading.copy(), 0
    for leg in legs:
        number = n.number[leg]
        if number == r.MUTE:
            continue
        reading[:] = true
        reading[number::LEGS] = true[leg::LEGS]
        asked.count, asked.legs[0] = 1, number
        count = call(n.answer, (n.end, n.asked, n.reading, into + total * _FRAME, senders + 8 * total))
        if count < 0:
            return int(count)
        integers_at(senders + 8 * total, count)[:] = leg
        total += count
    asked.count, asked.legs[: legs.shape[0]], reading[:] = legs.shape[0], legs, true
    return total


@helper
def _forge(n: Any) -> None:
    """Send forged answers with drives' node numbers, then restore the codec's memory of true readings."""
    reading, silent = codec.reading_at(n.reading), n.silent
    true = reading.length.copy()
    for leg in range(LEGS):
        if not np.isnan(n.forged[leg]):
            reading.length[:] = true + n.forged[leg]
            n.silent = ~(1 << leg)
            _put(n, _answers(n), -1)
    reading.length[:], n.silent = true, silent
    _answers(n)


@helper
def _latch(n: Any) -> int:
    """Sample the encoders and send answers; returns early for steps that only Python can do."""
    if n.latching == 1:
        status = move_to(n, n.t_ns)
        if status != r.DONE:
            return status
        n.latching = 2
        if n.look & r.LOOKS_BEFORE:
            return r.BEFORE_READING
    if n.latching == 2:
        _read(n)
        n.latching = 3
        if n.look & r.LOOKS_AFTER:
            return r.AFTER_READING
    codec.reading_at(n.reading).length[:] -= n.uncounted
    count = _answers(n)
    if count < 0:
        return r.ANSWER
    _put(n, count, -1)
    if n.look & r.FORGES:
        _forge(n)
    n.latching = 0
    return r.DONE


@helper
def _obey(n: Any, command: Any) -> int:
    status = move_to(n, n.t_ns)
    if status != r.DONE:
        return status
    entered = obey(n, command, n.t_ns)
    for k in range(command.count):
        if entered >> command.legs[k] & 1:
            _to_report(n, command.legs[k])
    return r.DONE


@helper
def _reaches(n: Any, message: Any) -> bool:
    """Replace node numbers in a message by the legs that have them; False if no drive has one."""
    numbers, force, count = message.legs[: message.count].copy(), message.force.copy(), 0
    for leg in range(LEGS):
        for k in range(numbers.shape[0]):
            if n.number[leg] == numbers[k]:
                message.legs[count], message.force[count] = leg, force[k]
                count += 1
    message.count = count
    return count > 0


@helper
def _hear(n: Any) -> int:
    at = n.messages + n.message * _MESSAGE
    message = codec.message_at(at)
    kind = message.kind
    if kind == codec.REJECTED:
        n.rejected += 1
    elif n.wired and not _reaches(n, message):
        pass
    elif kind == codec.SYNC:
        n.syncs += 1
        integers_at(n.asked, _MESSAGE_WORDS)[:] = integers_at(at, _MESSAGE_WORDS)
        n.latching = 1
    elif kind in (codec.COMMAND, codec.UNWATCHED):
        status = _obey(n, message)
        if status != r.DONE:
            return status
    elif kind == codec.ANSWER:
        integers_at(n.out + n.sent * _FRAME, _FRAME_WORDS)[:] = integers_at(message.counter, _FRAME_WORDS)
        _put(n, 1, message.legs[0])
    elif kind == codec.STOP:
        status = _fail(n, message.legs[: message.count], _ESTOP)
        if status != r.DONE:
            return status
    else:
        for leg in message.legs[: message.count]:
            if kind == codec.ALIVE:
                feed(n, leg, n.t_ns)
            elif configure(n, leg, message):
                _to_report(n, leg)
            else:
                n.rejected += 1
    n.message += 1
    return r.DONE


@kernel(NODES_RECORD, records(FRAME), INTEGER, BOOLEAN, unlocked=True)
def live(n: Any, received: Any, until_ns: int, again: bool) -> int:
    """Advance the drives and the plant to `until_ns`, receiving frames in the order of time.

    again: continue a call that has returned early. Returns the reason, see `record`; DONE at the end.
    """
    frames: Any = np.int64(received.ctypes.data)
    count = received.shape[0]
    if not again:
        n.until_ns = until_ns
        n.frame = n.heard = n.message = n.latching = n.pending = n.reported = n.sent = 0
        if not in_order(received):
            return r.UNSORTED
    while n.frame <= count:
        status = r.DONE
        if n.sent + r.ROOM > n.room:
            status = r.FULL
        elif n.reported < n.pending:
            _report(n)
        elif n.latching:
            status = _latch(n)
        elif n.message < n.heard:
            status = _hear(n)
        else:
            status = _pass_time(n, frames, count)
        if status != r.DONE:
            return status
    return r.DONE
