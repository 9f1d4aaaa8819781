"""Device side of the cyclic frames, compiled: six feedbacks to bytes, a command to forces.

Fields are little-endian; checks as in `drivers.legs.crc`.
"""

from typing import Any

import numpy as np

from drivers.arrays import Array, Bytes, Ints
from drivers.compiled.compiler import DATA, INTEGER, INTEGERS, OUT_BYTES, OUT_VECTOR, VECTOR, kernel
from drivers.legs.crc import FINAL_XOR, RESIDUE
from drivers.legs.kernels import (
    CHECK_AT,
    CHECK_SIZE,
    COUNTER_AT,
    COUNTER_SIZE,
    FEEDBACK_SIZE,
    FIELD,
    FORCE_AT,
    FORCE_KIND,
    FORCE_SIZE,
    LAST_AT,
    MODE_AT,
    MODE_SIZE,
    QUANTITIES,
    check_of,
    integer,
    natural,
    read,
    register_after,
    write,
)
from drivers.signals import LEGS, DriveMode

BROKEN, UNKNOWN_MODE, UNFIT = -1, -2, -3
"""Why a command cannot be trusted."""
_MODES = len(DriveMode)


@kernel(DATA, INTEGER)
def intact(data: Any, register: int) -> bool:
    """Tell whether `data`, bytes, ends in its own CRC-8, starting from a register."""
    return bool(register_after(data, 0, len(data), register) == RESIDUE)


@kernel(DATA, INTEGER, INTEGERS, VECTOR, OUT_VECTOR)
def decode_command(data: Any, register: int, form: Ints, scale: Array, force: Array) -> int:
    """Fill `force`, N, from `data`, bytes of the right number; return mode << 8 | counter.

    register: check after the identifier; form and scale as for `drivers.legs.kernels.encode`. Returns BROKEN,
    UNKNOWN_MODE or UNFIT, the first that holds, of a frame that cannot be trusted. Bytes behind the check,
    which it does not cover, are 0 or the frame is BROKEN.
    """
    place, size = form[CHECK_AT], form[CHECK_SIZE]
    if check_of(data, 0, place, register, size) != integer(data, place, size):
        return BROKEN
    for k in range(place + size, len(data)):
        if data[k]:
            return BROKEN
    mode = natural(data, 0, form[MODE_AT], form[MODE_SIZE])
    if mode >= _MODES:
        return UNKNOWN_MODE
    word = np.empty(1, np.int64)
    for k in range(force.shape[0]):
        bit = form[FORCE_AT] + k * form[FORCE_SIZE]
        value = read(data, 0, bit, form[FORCE_SIZE], form[FORCE_KIND], word)
        if not scale[1] <= value <= scale[2]:
            return UNFIT
        force[k] = value if form[FORCE_KIND] else value * scale[0]
    return mode << 8 | natural(data, 0, form[COUNTER_AT], form[COUNTER_SIZE])


@kernel(VECTOR, VECTOR, VECTOR, INTEGERS, INTEGER, INTEGERS, INTEGERS, VECTOR, OUT_BYTES)
def encode_feedbacks(
    length: Array,
    rate: Array,
    force: Array,
    state: Ints,
    counter: int,
    identifiers: Ints,
    form: Ints,
    scale: Array,
    data: Bytes,
) -> int:
    """Fill `data` with the feedbacks of all legs, one after the other; what exceeds its field saturates.

    length, rate, force, state (6,): m, m/s, N, as in `LegsProtocol.answer`; counter 0..15; identifiers,
    form and scale as for `drivers.legs.kernels.fold`. Returns the first leg with a value that is no number,
    or -1.
    """
    word = np.empty(1, np.int64)
    size = form[FEEDBACK_SIZE]
    data[:] = 0
    for leg in range(LEGS):
        start = leg * size
        for k in range(QUANTITIES):
            field = FIELD + 3 * k
            if form[field + 1] == 0:
                continue
            value = length[leg] if k == 0 else rate[leg] if k == 1 else force[leg]
            if np.isnan(value):
                return leg
            value = min(max(value, scale[QUANTITIES + k]), scale[2 * QUANTITIES + k])
            if not form[field + 2]:
                value = np.rint(value / scale[k])
            write(value, data, start, form[field], form[field + 1], form[field + 2], word)
        data[start + form[LAST_AT]] = state[leg] << 4 | counter
        end = start + size - 1
        data[end] = register_after(data, start, end, identifiers[LEGS + leg]) ^ FINAL_XOR
    return -1
