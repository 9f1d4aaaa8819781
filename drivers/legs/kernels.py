"""Cyclic frames, all legs in one call: feedback to SI, forces to bytes.

Fields are little-endian; checks as in `drivers.legs.crc`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from drivers.arrays import Array, Bytes, Ints
from drivers.compiled.compiler import (
    DATA,
    INTEGER,
    INTEGERS,
    OUT_BYTES,
    VECTOR,
    direct,
    helper,
    kernel,
    record,
)
from drivers.legs.crc import FINAL_XOR, RESIDUE, TABLE, TABLE_16
from drivers.protocol import ERROR, EXTENDED, HEAD, OTHER_BUSES, REMOTE
from drivers.signals import INVALID, LEGS, NEVER, DriveFault, DriveState, Foreign
from drivers.tick_columns import TICK, part

FOREIGN = EXTENDED | REMOTE | ERROR | OTHER_BUSES
"""Flags of frames that cannot be ours."""
OLDEST = 8
"""Of the 16 counter values, these many ticks back count as late; the rest are refused."""
_HEAD = HEAD.size
QUANTITIES = 3
"""Of a feedback: length, rate, force."""
FEEDBACK_SIZE, STATUS_SIZE, STATE_AT, FAULT_AT, SETUP_AT, LAST_AT, CHECKED, FIELD = range(8)
"""Places in `form` of `fold`: bytes of a feedback and of a status; the bytes of state, fault and set-up in a
status, of state and counter in a feedback; whether values are checked against their range; then first bit,
bits and kind (1: float64) of each quantity, no bits where there is none."""
_FEEDBACK, _STATUS = 0, 2 * LEGS
OTHERS = 4 * LEGS
"""Place in `identifiers` of `fold`: E-stop, SYNC, the six CONFIG, and the commands of all layouts."""
_ESTOP, _SYNC, _CONFIG, _COMMAND = OTHERS, OTHERS + 1, OTHERS + 2, OTHERS + 2 + LEGS
FORCE_AT, FORCE_SIZE, FORCE_KIND, COUNTER_AT, COUNTER_SIZE = range(5)
MODE_AT, MODE_SIZE, CHECK_AT, CHECK_SIZE, FORCES, FRAME = range(5, 11)
"""Places in `form` of `encode`: first force, its bits and kind; first bit and bits of counter and mode; first
byte and bytes of the check; forces in a frame; then size and register of that check after the identifier of
each frame. Forces beyond the last frame are not sent."""
_STATES = len(DriveState)
_FAULTS = len(DriveFault)
_BOOT = int(DriveState.BOOT)
_FOREIGN_SYNC, _FOREIGN_COMMAND = int(Foreign.SYNC), int(Foreign.COMMAND)
_FOREIGN_CONFIG, _FOREIGN_ESTOP = int(Foreign.CONFIG), int(Foreign.ESTOP)
_TABLE = np.array(TABLE, np.uint8)
_TABLE_16 = np.array(TABLE_16, np.int64)
_TICK = record(TICK, "tick", *part("measurement"))


@helper
def integer(data: Any, at: int, size: int) -> int:
    """Return `size` bytes at `at` as an integer, signed only if there are eight."""
    value = 0
    for k in range(size):
        value |= int(data[at + k]) << (8 * k)
    return value


@helper
def natural(data: Any, at: int, start: int, bits: int) -> int:
    """Return the field of up to 32 bits, or 64 on a byte, that begins `start` bits behind byte `at`."""
    shift = start & 7
    value = integer(data, at + (start >> 3), (shift + bits + 7) >> 3) >> shift
    return value if bits == 64 else value & ((1 << bits) - 1)


@helper
def read(data: Any, at: int, start: int, bits: int, is_float: int, word: Ints) -> float:
    """Return a field, see `natural`, as a signed integer or a float64; `word` (1,) is scratch."""
    unused = 64 - bits
    word[0] = (natural(data, at, start, bits) << unused) >> unused
    return float(word.view(np.float64)[0]) if is_float else float(word[0])


@helper
def put(value: int, data: Bytes, at: int, start: int, bits: int) -> None:
    """Put the low bits of an integer into a field that is 0, see `natural`."""
    shift = start & 7
    raw = value if bits == 64 else (value & ((1 << bits) - 1)) << shift
    for k in range((shift + bits + 7) >> 3):
        data[at + (start >> 3) + k] |= (raw >> (8 * k)) & 0xFF


@helper
def write(value: float, data: Bytes, at: int, start: int, bits: int, is_float: int, word: Ints) -> None:
    """Put a value that fits into its field, which is 0; see `read`."""
    if is_float:
        word.view(np.float64)[0] = value
    else:
        word[0] = np.int64(value)
    put(word[0], data, at, start, bits)


@helper
def register_after(data: Any, start: int, end: int, register: int) -> int:
    """Return the CRC-8 register after data[start:end]."""
    for k in range(start, end):
        register = int(_TABLE[register ^ int(data[k])])
    return register


@helper
def check_of(data: Any, start: int, end: int, register: int, size: int) -> int:
    """Return the check of data[start:end], `size` bytes long, from the register after the identifier."""
    if size == 1:
        return register_after(data, start, end, register) ^ FINAL_XOR
    for k in range(start, end):
        register = ((register << 8) & 0xFFFF) ^ _TABLE_16[(register >> 8) ^ int(data[k])]
    return register


@helper
def _take_feedback(
    run: Any,
    at: int,
    early: bool,
    leg: int,
    form: Ints,
    scale: Array,
    value: Array,
    word: Ints,
    last: Any,
    tick: Any,
) -> bool:
    """Take an intact feedback; tell whether it can be believed. `value` and `word` are scratch."""
    counted = int(run[at + form[LAST_AT]])
    behind = (tick.tick - counted) & 0xF
    state = counted >> 4 & ~INVALID
    invalid = counted >> 4 & INVALID != 0
    if behind > OLDEST or state >= _STATES or (early and behind == 0):
        return False
    for k in range(QUANTITIES):
        start, bits = form[FIELD + 3 * k], form[FIELD + 3 * k + 1]
        if bits > 0:
            raw = read(run, at, start, bits, form[FIELD + 3 * k + 2], word)
            low, high = scale[QUANTITIES + k], scale[2 * QUANTITIES + k]
            if form[CHECKED] and not low <= raw <= high:
                return False
            value[k] = raw * scale[k]
    has_force = form[FIELD + 3 * QUANTITIES - 2] > 0
    blind = tick.blind[leg] != 0
    if behind == tick.age[leg] or (blind and behind == 0):  # answers the SYNC of what is held
        same = invalid == (blind and behind == 0)
        if not invalid:
            same = same and value[0] == tick.length[leg] and value[1] == tick.rate[leg]
        if behind == 0 or (not blind and last.blind[leg] == 0):
            same = same and state == tick.drive_state[leg]
            same = same and (not has_force or value[2] == tick.drive_force[leg])
        if not same:
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
def _take_status(
    run: Any, at: int, leg: int, form: Ints, expected: Any, confirmed: int, tick: Any
) -> tuple[bool, int]:
    """Take an intact status; tell whether it can be believed, and who has confirmed the set-up."""
    state, fault = int(run[at + form[STATE_AT]]), int(run[at + form[FAULT_AT]])
    if state >= _STATES or fault >= _FAULTS:
        return False, confirmed
    tick.drive_fault[leg] = fault
    if state != _BOOT and integer(run, at + form[SETUP_AT], 2) == integer(expected, 2 * leg, 2):
        return True, confirmed | 1 << leg
    if state != _BOOT:
        tick.altered |= 1 << leg
    return True, confirmed & ~(1 << leg)


@helper
def _begin(last: Any, tick: Any) -> None:
    """Let the measurement of a tick begin as that of the last one, a little older."""
    tick.length[:] = last.length
    tick.rate[:] = last.rate
    tick.drive_force[:] = last.drive_force
    tick.drive_state[:] = last.drive_state
    tick.drive_fault[:] = last.drive_fault
    gone = tick.tick - last.tick if last.tick >= 0 else 1
    for leg in range(LEGS):
        tick.age[leg] = min(NEVER, last.age[leg] + gone)
        tick.blind[leg] = 0
    tick.foreign = tick.doubled = tick.altered = 0


@helper
def _foreign(identifier: int, identifiers: Ints) -> int:
    """Return which frame of the controller has this identifier; the own ones are not received."""
    for k in range(OTHERS, identifiers.shape[0]):
        if identifier == identifiers[k]:
            if k >= _COMMAND:
                return _FOREIGN_COMMAND
            if k >= _CONFIG:
                return _FOREIGN_CONFIG
            return _FOREIGN_SYNC if k == _SYNC else _FOREIGN_ESTOP
    return 0


@direct(DATA, INTEGER, INTEGERS, INTEGERS, VECTOR, DATA, INTEGER, _TICK, _TICK)
def fold(
    run: Any,
    since_ns: int,
    identifiers: Ints,
    form: Ints,
    scale: Array,
    expected: Any,
    confirmed: int,
    last: Any,
    tick: Any,
) -> int:
    """Fill the measurement of a tick from that of the last one and the frames since.

    run: bytes of `drivers.protocol.run_of`; the rules are those of `LegsProtocol.decode`. identifiers: of
    the feedbacks, the CRC-8 registers after them, of the statuses, theirs, then OTHERS. scale (9,): scales,
    least and largest values of the quantities, SI. form: see above. expected: two bytes a leg, the checksum
    of its set-up; confirmed: bit i, drive i has confirmed it. Returns the latter as it is now.
    """
    word = np.empty(1, np.int64)
    value = np.zeros(QUANTITIES)
    _begin(last, tick)
    rejected = 0
    end = 0
    while end < len(run):
        t_ns = integer(run, end, 8)
        identifier = integer(run, end + 8, 4)
        flags, size = integer(run, end + 12, 2), integer(run, end + 14, 2)
        at = end + _HEAD
        end = at + size
        if flags & FOREIGN:
            continue
        ours = False
        for k in range(LEGS):
            if identifier == identifiers[_FEEDBACK + k]:
                ours = True
                register = identifiers[_FEEDBACK + LEGS + k]
                good = size == form[FEEDBACK_SIZE] and register_after(run, at, end, register) == RESIDUE
                early = t_ns < since_ns
                if not good or not _take_feedback(run, at, early, k, form, scale, value, word, last, tick):
                    rejected += 1
                break
            if identifier == identifiers[_STATUS + k]:
                ours = True
                register = identifiers[_STATUS + LEGS + k]
                good = size == form[STATUS_SIZE] and register_after(run, at, end, register) == RESIDUE
                if good:
                    good, confirmed = _take_status(run, at, k, form, expected, confirmed, tick)
                if not good:
                    rejected += 1
                break
        if not ours:
            tick.foreign |= _foreign(identifier, identifiers)
    tick.rejected = rejected
    tick.counted_age[:] = tick.age
    return confirmed


@kernel(VECTOR, INTEGER, INTEGER, INTEGERS, VECTOR, OUT_BYTES)
def encode(force: Array, counter: int, mode: int, form: Ints, scale: Array, data: Bytes) -> bool:
    """Fill `data` with a tick's command frames, one after the other; False if the forces do not fit.

    force (6,) N; of the counter as many bits as there is room for. scale (3,): scale, least and largest
    force; the two in N where forces are float64, in steps where they are rounded. form: see above.
    """
    word = np.empty(1, np.int64)
    frames = (form.shape[0] - FRAME) // 2
    share = form[FORCES]
    start = 0
    data[:] = 0
    if force.shape[0] != LEGS:
        return False
    for frame in range(frames):
        for k in range(share):
            value = force[frame * share + k]
            if not form[FORCE_KIND]:
                value = np.rint(value / scale[0])
            if not scale[1] <= value <= scale[2]:
                return False
            bit = form[FORCE_AT] + k * form[FORCE_SIZE]
            write(value, data, start, bit, form[FORCE_SIZE], form[FORCE_KIND], word)
        put(counter, data, start, form[COUNTER_AT], form[COUNTER_SIZE])
        put(mode, data, start, form[MODE_AT], form[MODE_SIZE])
        place, size = start + form[CHECK_AT], form[CHECK_SIZE]
        check = check_of(data, start, place, form[FRAME + 1 + 2 * frame], size)
        put(check, data, place, 0, 8 * size)
        start += form[FRAME + 2 * frame]
    return True
