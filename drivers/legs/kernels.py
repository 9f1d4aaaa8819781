"""Cyclic frames, all legs in one call: feedback to SI, forces to bytes.

Fields are little-endian; CRC as in `drivers.legs.crc`.
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
from drivers.legs.crc import FINAL_XOR, RESIDUE, TABLE
from drivers.protocol import ERROR, EXTENDED, HEAD, OTHER_BUSES, REMOTE
from drivers.signals import INVALID, LEGS, NEVER, DriveFault, DriveState
from drivers.tick_columns import TICK, part

FOREIGN = EXTENDED | REMOTE | ERROR | OTHER_BUSES
"""Flags of frames that cannot be ours."""
OLDEST = 8
"""Of the 16 counter values, these many ticks back count as late; the rest are refused."""
_HEAD = HEAD.size
QUANTITIES = 3
"""Of a feedback: length, rate, force."""
FEEDBACK_SIZE, STATUS_SIZE, STATE_AT, FAULT_AT, LAST_AT, CHECKED, FIELD = range(7)
"""Places in `form` of `fold`: bytes of a feedback and of a status; the bytes of state and fault in a status,
of state and counter in a feedback; whether values are checked against their range; then start, size and kind
(1: float64) of each quantity, size 0 where there is none."""
FORCE_AT, FORCE_SIZE, FORCE_KIND, MODE_AT, FRAME = range(5)
"""Places in `form` of `encode`: first force, its bytes and kind, mode and counter; then size and CRC register
after the identifier of each frame."""
_STATES = len(DriveState)
_FAULTS = len(DriveFault)
_TABLE = np.array(TABLE, np.uint8)
_TICK = record(TICK, "tick", *part("measurement"))


@helper
def integer(data: Any, at: int, size: int) -> int:
    """Return `size` bytes at `at` as an integer, signed only if there are eight."""
    value = 0
    for k in range(size):
        value |= int(data[at + k]) << (8 * k)
    return value


@helper
def read(data: Any, at: int, size: int, is_float: int, word: Ints) -> float:
    """Return the field of `size` bytes at `at`, a signed integer or a float64; `word` (1,) is scratch."""
    unused = 64 - 8 * size
    word[0] = (integer(data, at, size) << unused) >> unused
    return float(word.view(np.float64)[0]) if is_float else float(word[0])


@helper
def write(value: float, data: Bytes, at: int, size: int, is_float: int, word: Ints) -> None:
    """Put a value that fits into its field; see `read`."""
    if is_float:
        word.view(np.float64)[0] = value
    else:
        word[0] = np.int64(value)
    for k in range(size):
        data[at + k] = (word[0] >> (8 * k)) & 0xFF


@helper
def register_after(data: Any, start: int, end: int, register: int) -> int:
    """Return the CRC register after data[start:end]."""
    for k in range(start, end):
        register = int(_TABLE[register ^ int(data[k])])
    return register


@direct(DATA, INTEGER, INTEGERS, INTEGERS, VECTOR, _TICK, _TICK)
def fold(run: Any, since_ns: int, identifiers: Ints, form: Ints, scale: Array, last: Any, tick: Any) -> None:
    """Fill the measurement of a tick from that of the last one and the frames since.

    run: bytes of `drivers.protocol.run_of`; the rules are those of `LegsProtocol.decode`. identifiers (18,):
    of
    the feedbacks, the CRC registers after them, of the statuses. scale (9,): scales, least and largest values
    of the quantities, SI. form: see above.
    """
    word = np.empty(1, np.int64)
    value = np.zeros(QUANTITIES)
    tick.length[:] = last.length
    tick.rate[:] = last.rate
    tick.drive_force[:] = last.drive_force
    tick.drive_state[:] = last.drive_state
    tick.drive_fault[:] = last.drive_fault
    gone = tick.tick - last.tick if last.tick >= 0 else 1
    age, blind = tick.age, tick.blind
    for leg in range(LEGS):
        age[leg] = min(NEVER, last.age[leg] + gone)
        blind[leg] = 0
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
        for leg in range(LEGS):
            if identifier == identifiers[leg]:
                intact = register_after(run, at, end, identifiers[LEGS + leg]) == RESIDUE
                if size != form[FEEDBACK_SIZE] or not intact:
                    rejected += 1
                    break
                counted = int(run[at + form[LAST_AT]])
                behind = (tick.tick - counted) & 0xF
                early = behind == 0 and t_ns < since_ns
                drive_state = counted >> 4 & ~INVALID
                credible = behind <= OLDEST and drive_state < _STATES and not early
                for k in range(QUANTITIES):
                    field = FIELD + 3 * k
                    if form[field + 1] > 0:
                        value[k] = read(run, at + form[field], form[field + 1], form[field + 2], word)
                        low, high = scale[QUANTITIES + k], scale[2 * QUANTITIES + k]
                        credible = credible and (not form[CHECKED] or low <= value[k] <= high)
                invalid = counted >> 4 & INVALID != 0
                if not credible:
                    rejected += 1
                elif behind == 0 if invalid else behind < age[leg]:
                    if form[FIELD + 7] > 0:
                        tick.drive_force[leg] = value[2] * scale[2]
                    tick.drive_state[leg] = drive_state
                    if invalid:
                        blind[leg] = 1
                    else:
                        tick.length[leg] = value[0] * scale[0]
                        tick.rate[leg] = value[1] * scale[1]
                        age[leg] = behind
                break
            if identifier == identifiers[2 * LEGS + leg]:
                said, broken = at + form[STATE_AT], at + form[FAULT_AT]
                if size != form[STATUS_SIZE] or run[said] >= _STATES or run[broken] >= _FAULTS:
                    rejected += 1
                else:
                    tick.drive_fault[leg] = run[broken]
                break
    tick.rejected = rejected
    tick.counted_age[:] = age


@kernel(VECTOR, INTEGER, INTEGERS, VECTOR, OUT_BYTES)
def encode(force: Array, last: int, form: Ints, scale: Array, data: Bytes) -> bool:
    """Fill `data` with a tick's command frames, one after the other; False if the forces do not fit.

    force (6,) N; last: mode and counter. scale (3,): scale, least and largest force; the two in N where
    forces are float64, in steps where they are rounded. form: see above.
    """
    word = np.empty(1, np.int64)
    frames = (form.shape[0] - FRAME) // 2
    share = LEGS // frames
    start = 0
    data[:] = 0
    if force.shape[0] != LEGS:
        return False
    for frame in range(frames):
        end = start + form[FRAME + 2 * frame]
        for k in range(share):
            value = force[frame * share + k]
            if not form[FORCE_KIND]:
                value = np.rint(value / scale[0])
            if not scale[1] <= value <= scale[2]:
                return False
            at = start + form[FORCE_AT] + k * form[FORCE_SIZE]
            write(value, data, at, form[FORCE_SIZE], form[FORCE_KIND], word)
        data[start + form[MODE_AT]] = last
        data[end - 1] = register_after(data, start, end - 1, form[FRAME + 1 + 2 * frame]) ^ FINAL_XOR
        start = end
    return True
