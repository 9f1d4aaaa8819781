"""Kernels of the protocol `legs` for the controller: feedback frames to SI values, leg forces to frames.

Fields are little-endian, those of 64 bits float64. Frames end in a check of `drivers.legs.crc`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from drivers.arrays import Array, Bytes, Ints
from drivers.compiled.compiler import INTEGER, helper, record
from drivers.compiled.pointed import FAILED, pointed, reals_at, records_at
from drivers.frame_pointers import begin_measurement, begin_sent, frames_at, place_of, signed, whole
from drivers.legs.crc import check_of, intact
from drivers.protocol import ERROR, EXTENDED, REMOTE
from drivers.signals import INVALID, LEGS, DriveFault, DriveState, Foreign
from drivers.tick_columns import TICK, part

STRANGE = EXTENDED | REMOTE | ERROR
"""Flags that frames of this protocol never have."""
OLDEST = 8
"""Most ticks by which an answer may be late, of 16 counter values; other values are refused."""
ROUND = 0xFFFF
"""The last 16 SYNCs, whose counters differ, as bits."""
HISTORY = 48
"""Last ticks whose SYNC may still be answered."""
QUANTITIES = 3
"""Quantities of a feedback: length, rate, force."""
EXACT = 64
"""Bits of a float64, which is not rounded and whose range has to be checked."""
COMMAND_IDS = 5
COMMAND = np.dtype(
    [
        *((name, "<i8") for name in ("id", "flags", "bus", "length", "legs", "forces", "first", "bits")),
        *((name, "<i8", (2,)) for name in ("counter", "mode", "check")),
        ("leg", "<i8", (LEGS,)),
    ]
)
"""A command frame of a bus: its number of legs, and of places for forces; bits of a force, first bit of the
first force; first bit and bits of other fields; the leg of each force, -1: none."""
ENDS = np.dtype(
    [
        *((name, "<i8", (LEGS,)) for name in ("feedback", "status", "config", "place", "home")),
        *((name, "<i8") for name in ("sync", "sync_length", "estop", "version", "rated_mN", "buses")),
        *((name, "<i8") for name in ("feedback_length", "feedback_flags", "counter_at")),
        *((name, "<i8") for name in ("status_length", "status_flags", "commands", "frames")),
        ("command_ids", "<i8", (COMMAND_IDS,)),
        *((name, "<i8", (QUANTITIES,)) for name in ("start", "bits")),
        *((name, "<f8", (QUANTITIES,)) for name in ("scale", "low", "high")),
        *((name, "<f8") for name in ("step", "least", "most", "watchdog_s")),
        *((name, "<i8", (LEGS,)) for name in ("expected", "said", "sent", "owed", "doubt")),
        *((name, "<i8") for name in ("confirmed", "interval", "answered")),
        ("present", "<i8", (LEGS,)),
    ]
)
"""Record of both ends. Tables: each leg's identifiers, its place in the command, from 1 on, and its bus;
identifiers and bytes of the other frames; the byte of a feedback with counter and state; address of `frames`
COMMAND records; identifiers of the commands of all layouts; of each quantity first bit, bits (0:
missing), scale and range, SI; of a force step and range, in steps if it is rounded, else N; step of the
watchdog, s.

State of the controller: checksum of each leg's set-up, checksum in its last status, number of CONFIG sent
to it; the SYNCs that its drive may still answer, bit k: that of k ticks ago; ticks in which its answers
were in doubt, see `_pay`, 0: they are not; bit i: the last status of drive i has confirmed it; ticks from
one CONFIG of a drive to its next; bit i: an answer of drive i in this tick. State of the drives: Cycle of
the present SYNC of each bus."""
NO_SYNC = -1
"""SYNC counter of drives that have received no SYNC yet."""
CHANGED = 1
"""Status of `decode`: not all drives have confirmed their set-up, or one has just confirmed it."""
ends: Any = record(ENDS)
commands_at: Any = records_at(record(COMMAND))
_STATES = len(DriveState)
_FAULTS = len(DriveFault)
_ALL = (1 << LEGS) - 1
_TICK = record(TICK, "tick", *part("measurement"))


@helper
def natural(data: Any, start: int, bits: int) -> int:
    """Unsigned field of up to 32 bits from bit `start`; one of 64 bits must start at a byte."""
    value = whole(data, start >> 3, ((start & 7) + bits + 7) >> 3) >> (start & 7)
    return value if bits == EXACT else value & ((1 << bits) - 1)


@helper
def read(data: Any, start: int, bits: int, word: Ints) -> float:
    """Field of data as a number: signed integer, or float64 if it has 64 bits; `word` (1,) is scratch."""
    word[0] = natural(data, start, bits)
    return float(word.view(np.float64)[0]) if bits == EXACT else float(signed(word[0], bits))


@helper
def put(value: int, data: Bytes, start: int, bits: int) -> None:
    """Write the low `bits` bits of an integer into a field of data that is 0, from bit `start`."""
    shift = start & 7
    raw = value if bits == EXACT else (value & ((1 << bits) - 1)) << shift
    for k in range((shift + bits + 7) >> 3):
        data[(start >> 3) + k] |= (raw >> (8 * k)) & 0xFF


@helper
def write(value: float, data: Bytes, start: int, bits: int, word: Ints) -> None:
    """Write a value in range into a field that is 0: signed integer, or float64 if it has 64 bits."""
    if bits == EXACT:
        word.view(np.float64)[0] = value
    else:
        word[0] = np.int64(value)
    put(word[0], data, start, bits)


@helper
def _owe(e: Any, elapsed: int) -> None:
    """Start a tick: each confirmed drive owes an answer to its SYNC, and may owe earlier ones."""
    for leg in range(LEGS):
        earlier = e.owed[leg] << min(elapsed, HISTORY) if e.confirmed >> leg & 1 else 0
        e.owed[leg] = (earlier | 1) & (1 << HISTORY) - 1
        if e.owed[leg] <= ROUND:
            e.doubt[leg] = 0
        elif e.doubt[leg] > 0:
            e.doubt[leg] += e.answered >> leg & 1
    e.answered = 0


@helper
def _pay(e: Any, leg: int, behind: int) -> bool:
    """Count an answer; True if it belongs to a SYNC of an earlier round of the counter.

    Frames of a node keep their order: an answer belongs to the oldest SYNC with its counter that has none
    yet, and SYNCs before that one no longer get any. A drive that missed 16 SYNCs and then answers in time
    sends the same frames as one that stays 16 ticks late. It is taken to be in time after OLDEST ticks with
    an answer: so long it is in doubt.
    """
    for earlier in (32, 16, 0):
        bit = np.int64(1) << earlier + behind
        if e.owed[leg] & bit and (earlier == 0 or e.doubt[leg] <= OLDEST):
            e.owed[leg] &= bit - 1
            e.answered |= 1 << leg
            if earlier:
                e.doubt[leg] = max(e.doubt[leg], 1)
            return earlier > 0
    return False


@helper
def _take_feedback(
    e: Any, data: Any, early: bool, leg: int, value: Array, word: Ints, last: Any, tick: Any
) -> bool:
    counted = int(data[e.counter_at])
    behind = (tick.tick - counted) & 0xF
    state = counted >> 4 & ~INVALID
    invalid = counted >> 4 & INVALID != 0
    if state >= _STATES:
        return False
    if early and behind == 0:
        e.owed[leg] &= ROUND
        return False
    if _pay(e, leg, behind):
        return True
    if behind > OLDEST:
        return False
    for k in range(QUANTITIES):
        if e.bits[k] > 0:
            raw = read(data, e.start[k], e.bits[k], word)
            if e.bits[k] == EXACT and not e.low[k] <= raw <= e.high[k]:
                return False
            value[k] = raw * e.scale[k]
    has_force = e.bits[QUANTITIES - 1] > 0
    blind = tick.blind[leg] != 0
    if behind == tick.age[leg] or (blind and behind == 0):  # answers the same SYNC as the one held
        same = invalid == (blind and behind == 0)
        if not invalid:
            same = same and value[0] == tick.length[leg] and value[1] == tick.rate[leg]
        if behind == 0 or (not blind and last.blind[leg] == 0):
            same = same and state == tick.drive_state[leg]
            same = same and (not has_force or value[2] == tick.drive_force[leg])
        if not same and e.doubt[leg] == 0:
            tick.doubled |= 1 << leg
    elif (invalid and behind == 0) or (not invalid and behind < tick.age[leg]):
        if has_force:
            tick.drive_force[leg] = value[2]
        tick.drive_state[leg] = state
        if invalid:
            tick.blind[leg] = 1
        else:
            tick.length[leg], tick.rate[leg], tick.age[leg] = value[0], value[1], behind
    return True


@helper
def _take_status(e: Any, data: Any, leg: int, tick: Any) -> bool:
    state, fault, mine = int(data[0]), int(data[1]), 1 << leg
    e.said[leg] = whole(data, 2, 2)
    if state >= _STATES or fault >= _FAULTS:
        return False
    tick.drive_fault[leg] = fault
    e.confirmed &= ~mine
    if state != DriveState.BOOT and e.said[leg] == e.expected[leg]:
        e.confirmed |= mine
    elif state != DriveState.BOOT:
        tick.altered |= mine
    return True


@helper
def _foreign(e: Any, identifier: int) -> int:
    if identifier == e.sync:
        return Foreign.SYNC.value
    if identifier == e.estop:
        return Foreign.ESTOP.value
    for k in range(COMMAND_IDS):
        if identifier == e.command_ids[k]:
            return Foreign.COMMAND.value
    return Foreign.CONFIG.value if place_of(identifier, e.config) >= 0 else 0


@pointed(ends, INTEGER, INTEGER, INTEGER, _TICK, _TICK)
def decode(e: Any, frames: int, count: int, since_ns: int, last: Any, tick: Any) -> int:
    """Fill the measurement of a tick from that of the last tick and the frames since, FRAME records.

    Every leg first ages by the ticks since the last one, up to NEVER. A feedback with this tick's counter has
    age 0, unless it came before `since_ns`: then it answers an older SYNC with the same four bits, and is
    refused. A feedback with a counter d = 1..8 ticks back takes effect with age d if it is newer than the one
    held, else it is skipped; any other counter is refused. After 16 SYNCs without answer one may be 16 or 32
    ticks older than its counter shows: it is skipped, see `_pay`. Refused as well, and counted in `rejected`:
    wrong length, CRC, state or fault; a value that is not finite; with several buses, another bus than the
    drive's. A feedback of this tick with an invalid length gives state and force only: the leg ages, and is
    `blind`. A second answer to the same SYNC with other content marks the node as `doubled`; the first one
    counts. SYNC, command, CONFIG and E-stop are `foreign`, whatever they carry: a node does not receive its
    own frames. Other frames are ignored. Fault and set-up come from the status, state from the feedback.
    Layout classic carries no force: the force keeps its value. Returns CHANGED if the set of configured
    drives changed, else 0.
    """
    word = np.empty(1, np.int64)
    value = np.zeros(QUANTITIES)
    before, rejected = e.confirmed, 0
    begin_measurement(last, tick)
    _owe(e, tick.tick - last.tick if last.tick >= 0 else 1)
    received = frames_at(frames, count)
    for n in range(count):
        frame = received[n]
        identifier: Any = np.int64(frame.id)
        bus = np.int64(frame.bus)
        leg = place_of(identifier, e.feedback)
        is_status = leg < 0
        if is_status:
            leg = place_of(identifier, e.status)
        strays = bus >= e.buses or (leg >= 0 and bus != e.home[leg])
        if strays and e.buses > 1:
            rejected += 1
        if strays or frame.flags & STRANGE:
            continue
        if leg < 0:
            tick.foreign |= _foreign(e, identifier)
            continue
        good = frame.length == (e.status_length if is_status else e.feedback_length) and intact(frame)
        if good and is_status:
            good = _take_status(e, frame.data, leg, tick)
        elif good:
            good = _take_feedback(e, frame.data, frame.t_ns < since_ns, leg, value, word, last, tick)
        if not good:
            rejected += 1
    tick.rejected = rejected
    tick.counted_age[:] = tick.age
    return 0 if e.confirmed == before == _ALL else CHANGED


@pointed(ends, INTEGER, INTEGER, INTEGER, INTEGER, INTEGER)
def command(e: Any, number: int, mode: int, _stop: int, force_at: int, into: int) -> int:
    """Write the frames of a tick's command to FRAME records at the address `into`; returns their number.

    number: of the tick; the counter takes as many of its low bits as fit. mode: a DriveMode. force_at:
    address of (6,) N, > 0 extends. Returns FAILED if a force does not fit. An emergency stop is a frame of
    its own.
    """
    forces, word = reals_at(force_at, LEGS), np.empty(1, np.int64)
    commands, sent = commands_at(e.commands, e.frames), frames_at(into, e.frames)
    for n in range(e.frames):
        of, frame = commands[n], sent[n]
        begin_sent(frame, of.id, of.length, of.flags, of.bus)
        data = frame.data
        for k in range(of.forces):
            value = forces[of.leg[k]] if of.leg[k] >= 0 else 0.0
            if of.bits != EXACT:
                value = float(np.rint(value / e.step))
            if not e.least <= value <= e.most:
                return FAILED
            write(value, data, of.first + k * of.bits, of.bits, word)
        put(number & 0xFF, data, of.counter[0], of.counter[1])
        put(mode, data, of.mode[0], of.mode[1])
        start, bits = of.check[0], of.check[1]
        put(check_of(of.id, data, start >> 3, bits >> 3), data, start, bits)
    return int(e.frames)
