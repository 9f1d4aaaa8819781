"""Cyclic frames, all legs in one call: feedback to SI, forces to bytes.

Fields are little-endian; checks as in `drivers.legs.crc`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from drivers.arrays import Array, Bytes, Ints
from drivers.compiled.compiler import INTEGER, helper, record
from drivers.compiled.pointed import FAILED, integers_at, pointed, reals_at
from drivers.frame_array import SENT
from drivers.frame_pointers import begin_measurement, frames_at
from drivers.legs.crc import FINAL_XOR, RESIDUE, TABLE, TABLE_16
from drivers.protocol import ERROR, EXTENDED, OTHER_BUSES, REMOTE
from drivers.signals import INVALID, LEGS, DriveFault, DriveState, Foreign
from drivers.tick_columns import TICK, part

FOREIGN = EXTENDED | REMOTE | ERROR | OTHER_BUSES
"""Flags of frames that cannot be ours."""
OLDEST = 8
"""Of the 16 counter values, these many ticks back count as late; the rest are refused."""
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
MODE_AT, MODE_SIZE, CHECK_AT, CHECK_SIZE, FORCES = range(5, 10)
"""Places in the form of a command frame: first force, its bits and kind; first bit and bits of counter and
mode; first byte and bytes of the check; forces in the frame."""
FRAME_ID, FRAME_FLAGS, FRAME_BUS, FRAME_SIZE, REGISTER, LEG = range(FORCES + 1, FORCES + 7)
"""Behind them: the frame itself, the register of its check after the identifier, and the leg of each force,
-1 where none has that place."""
COMMAND_FORM = LEG + LEGS
CODEC = np.dtype(
    [
        ("identifiers", "<i8"),  # address of the identifiers of `decode`
        ("known", "<i8"),  # how many they are
        ("form", "<i8", (FIELD + 3 * QUANTITIES,)),
        ("scale", "<f8", (3 * QUANTITIES,)),  # scales, least and largest values of the quantities, SI
        ("expected", "u1", (2 * LEGS,)),  # two bytes a leg: the checksum of its set-up
        ("confirmed", "<i8"),  # bit i: drive i has confirmed it
        ("buses", "<i8"),  # how many there are
        ("bus_of", "<i8", (LEGS,)),  # of each leg
        ("commands", "<i8"),  # address of (frames, COMMAND_FORM) integers
        ("steps", "<i8"),  # address of (frames, 3): step, least and largest force
        ("frames", "<i8"),  # how many carry a command
    ]
)
"""The controller's end of the drives: tables, and what it remembers. Forces are in N where they are float64,
in steps where they are rounded."""
CHANGED = 1
"""Status of `decode`: not all drives have confirmed their set-up, or one has just done so."""
_CODEC = record(CODEC)
_STATES = len(DriveState)
_FAULTS = len(DriveFault)
_BOOT = int(DriveState.BOOT)
_ALL = (1 << LEGS) - 1
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
    data: Any,
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
    counted = int(data[form[LAST_AT]])
    behind = (tick.tick - counted) & 0xF
    state = counted >> 4 & ~INVALID
    invalid = counted >> 4 & INVALID != 0
    if behind > OLDEST or state >= _STATES or (early and behind == 0):
        return False
    for k in range(QUANTITIES):
        start, bits = form[FIELD + 3 * k], form[FIELD + 3 * k + 1]
        if bits > 0:
            raw = read(data, 0, start, bits, form[FIELD + 3 * k + 2], word)
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
    data: Any, leg: int, form: Ints, expected: Any, confirmed: int, tick: Any
) -> tuple[bool, int]:
    """Take an intact status; tell whether it can be believed, and who has confirmed the set-up."""
    state, fault = int(data[form[STATE_AT]]), int(data[form[FAULT_AT]])
    if state >= _STATES or fault >= _FAULTS:
        return False, confirmed
    tick.drive_fault[leg] = fault
    if state != _BOOT and integer(data, form[SETUP_AT], 2) == integer(expected, 2 * leg, 2):
        return True, confirmed | 1 << leg
    if state != _BOOT:
        tick.altered |= 1 << leg
    return True, confirmed & ~(1 << leg)


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


@helper
def _sender(identifier: int, identifiers: Ints) -> int:
    """Return the place among the identifiers of a drive's feedback or status; -1: it is neither."""
    for k in range(LEGS):
        if identifier == identifiers[_FEEDBACK + k]:
            return _FEEDBACK + k
        if identifier == identifiers[_STATUS + k]:
            return _STATUS + k
    return -1


@pointed(_CODEC, INTEGER, INTEGER, INTEGER, _TICK, _TICK)
def decode(codec: Any, frames: int, count: int, since_ns: int, last: Any, tick: Any) -> int:
    """Fill the measurement of a tick, see `LegsProtocol.decode`.

    frames: address of `count` elements of FRAME. Returns CHANGED or 0.
    """
    identifiers = integers_at(codec.identifiers, codec.known)
    form, scale, expected = codec.form, codec.scale, codec.expected
    word = np.empty(1, np.int64)
    value = np.zeros(QUANTITIES)
    before = confirmed = codec.confirmed
    begin_measurement(last, tick)
    rejected = 0
    received = frames_at(frames, count)
    for n in range(count):
        frame = received[n]
        identifier, bus, size = int(frame.id), int(frame.bus), int(frame.length)
        place = _sender(identifier, identifiers)
        leg = place - _STATUS if place >= _STATUS else place
        if codec.buses > 1 and (bus >= codec.buses or (place >= 0 and bus != codec.bus_of[leg])):
            rejected += 1
        if frame.flags & FOREIGN or bus >= codec.buses or (place >= 0 and bus != codec.bus_of[leg]):
            continue
        if place < 0:
            tick.foreign |= _foreign(identifier, identifiers)
            continue
        is_status = place >= _STATUS
        data, register = frame.data, identifiers[place + LEGS]
        good = size == form[STATUS_SIZE if is_status else FEEDBACK_SIZE]
        good = good and register_after(data, 0, size, register) == RESIDUE
        if good and is_status:
            good, confirmed = _take_status(data, leg, form, expected, confirmed, tick)
        elif good:
            early = frame.t_ns < since_ns
            good = _take_feedback(data, early, leg, form, scale, value, word, last, tick)
        if not good:
            rejected += 1
    tick.rejected = rejected
    tick.counted_age[:] = tick.age
    codec.confirmed = confirmed
    return 0 if confirmed == before == _ALL else CHANGED


@helper
def _carried(value: float, is_float: int, step: float) -> float:
    """Return a force as its field has it: N, or rounded to whole steps."""
    return value if is_float else float(np.rint(value / step))


@pointed(_CODEC, INTEGER, INTEGER, INTEGER, INTEGER, INTEGER)
def command(codec: Any, number: int, mode: int, _stop: int, force_at: int, into: int) -> int:
    """Fill the elements of FRAME at `into` with the frames of a tick's command; return how many they are.

    number: of the tick, of whose low bits the counter has as many as there is room for; force_at: address of
    (6,) N. FAILED: a force does not fit. An emergency stop is a frame of its own.
    """
    forces = reals_at(force_at, LEGS)
    forms = integers_at(codec.commands, codec.frames * COMMAND_FORM)
    steps = reals_at(codec.steps, 3 * codec.frames)
    word = np.empty(1, np.int64)
    sent = frames_at(into, codec.frames)
    for n in range(codec.frames):
        form = forms[n * COMMAND_FORM : (n + 1) * COMMAND_FORM]
        frame = sent[n]
        frame.t_ns, frame.kind = 0, SENT
        frame.id, frame.flags, frame.bus = form[FRAME_ID], form[FRAME_FLAGS], form[FRAME_BUS]
        frame.length = form[FRAME_SIZE]
        data = frame.data
        data[:] = 0
        for k in range(form[FORCES]):
            leg = form[LEG + k]
            value = _carried(forces[leg] if leg >= 0 else 0.0, form[FORCE_KIND], steps[3 * n])
            if not steps[3 * n + 1] <= value <= steps[3 * n + 2]:
                return FAILED
            bit = form[FORCE_AT] + k * form[FORCE_SIZE]
            write(value, data, 0, bit, form[FORCE_SIZE], form[FORCE_KIND], word)
        put(number & 0xFF, data, 0, form[COUNTER_AT], form[COUNTER_SIZE])
        put(mode, data, 0, form[MODE_AT], form[MODE_SIZE])
        place, size = form[CHECK_AT], form[CHECK_SIZE]
        put(check_of(data, 0, place, form[REGISTER], size), data, place, 0, 8 * size)
    return int(codec.frames)
