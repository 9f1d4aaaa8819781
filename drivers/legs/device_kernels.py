"""The drives' end of the own protocol, compiled: SYNC and commands to messages, readings to feedbacks.

One record serves one bus and several. Fields are little-endian; checks as in `drivers.legs.crc`. CONFIG and
E-stop are the protocol's own affair.
"""

from typing import Any

import numpy as np

from drivers.arrays import Array, Ints
from drivers.compiled.compiler import DATA, INTEGER, helper, kernel, record
from drivers.compiled.pointed import FAILED, integers_at, pointed, reals_at, record_at
from drivers.ends import COMMAND, MESSAGE, REJECTED, SYNC, frame_at, message_at, reading_at
from drivers.frame_array import FRAME
from drivers.frame_pointers import begin_sent
from drivers.legs.crc import FINAL_XOR, RESIDUE, START_16
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
    STATUS_SIZE,
    check_of,
    integer,
    natural,
    read,
    register_after,
    write,
)
from drivers.protocol import ERROR, EXTENDED, REMOTE
from drivers.signals import LEGS, DriveMode

STRANGE = EXTENDED | REMOTE | ERROR
"""Flags of frames that cannot be ours."""
NO_SYNC = -1
"""Of drives that have heard no SYNC yet."""
SYNC_BROKEN, SYNC_REPEATED, LENGTH, BROKEN, UNKNOWN_MODE, UNFIT, NOT_PRESENT = range(7)
"""Why a frame cannot be trusted: `mode` of a message REJECTED; of the last one `counter` is the command's."""
_MODES = len(DriveMode)
COMMANDS = 2
"""At most so many command frames has a bus."""
BUS = np.dtype(
    [
        *((name, "<i8") for name in ("present", "legs", "form", "form_size", "scale", "mask", "commands")),
        ("leg", "<i8", (LEGS,)),
        *((name, "<i8", (COMMANDS,)) for name in ("id", "size", "register", "first", "forces")),
    ]
)
"""Cycle of the present SYNC of a bus; how many legs it has and which; addresses of `form` and `scale` of its
commands (`drivers.legs.kernels.encode`), which bits of a Cycle they carry; how many frames make a command,
their identifiers, bytes, check registers and which slots they have."""
END = np.dtype(
    [
        *((name, "<i8") for name in ("buses", "several", "bus", "identifiers", "form", "scale")),
        *((name, "<i8") for name in ("sync_id", "sync_size", "sync_register", "feedback_flags")),
        *((name, "<i8") for name in ("estop_id", "status_flags", "counter_at", "rated_mN", "version")),
        ("watchdog_s", "<f8"),
        *((name, "<i8", (LEGS,)) for name in ("home", "config_id", "slot")),
    ]
)
"""How many buses; whether a drive hears its own alone; address of a BUS each; tables of
`drivers.legs.kernels.fold`; identifiers, bytes, flags; the byte of a feedback's counter; of the set-up the
rated force, the protocol's version, the step of the watchdog, each leg's CONFIG and slot; the bus of each."""
_bus_at: Any = record_at(record(BUS))
_FRAME, _MESSAGE, _BUS = FRAME.itemsize, MESSAGE.itemsize, BUS.itemsize
_STATUS = 2 * LEGS
_CONFIG_SIZE = 7
"""Bytes of a CONFIG before its check: watchdog, reaction, slot, version."""


@kernel(DATA, INTEGER)
def intact(data: Any, register: int) -> bool:
    """Tell whether `data`, bytes, ends in its own CRC-8, starting from a register."""
    return bool(register_after(data, 0, len(data), register) == RESIDUE)


@helper
def _whole(data: Any, size: int, register: int) -> bool:
    return bool(register_after(data, 0, size, register) == RESIDUE)


@helper
def _command(data: Any, size: int, register: int, form: Ints, scale: Array, count: int, force: Array) -> int:
    """Fill `count` forces, N, from a command of the right size; return mode << 8 | counter.

    register: check after the identifier; form and scale as for `drivers.legs.kernels.encode`. Returns
    -BROKEN, -UNKNOWN_MODE or -UNFIT, the first that holds, of a frame that cannot be trusted. Bytes behind
    the check, which it does not cover, are 0 or the frame is BROKEN.
    """
    place, width = form[CHECK_AT], form[CHECK_SIZE]
    if check_of(data, 0, place, register, width) != integer(data, place, width):
        return -BROKEN
    for k in range(place + width, size):
        if data[k]:
            return -BROKEN
    mode = natural(data, 0, form[MODE_AT], form[MODE_SIZE])
    if mode >= _MODES:
        return -UNKNOWN_MODE
    word = np.empty(1, np.int64)
    for k in range(count):
        bit = form[FORCE_AT] + k * form[FORCE_SIZE]
        value = read(data, 0, bit, form[FORCE_SIZE], form[FORCE_KIND], word)
        if not scale[1] <= value <= scale[2]:
            return -UNFIT
        force[k] = value if form[FORCE_KIND] else value * scale[0]
    return mode << 8 | natural(data, 0, form[COUNTER_AT], form[COUNTER_SIZE])


@helper
def _reject(message: Any, why: int) -> int:
    message.kind, message.mode, message.count = REJECTED, why, 0
    return 1


@helper
def _parse_sync(end: Any, bus: Any, frame: Any, message: Any) -> int:
    if frame.length != end.sync_size or not _whole(frame.data, frame.length, end.sync_register):
        return _reject(message, SYNC_BROKEN)
    counter = np.int64(frame.data[0])
    if counter == bus.present:
        return _reject(message, SYNC_REPEATED)
    bus.present = counter
    message.kind, message.counter, message.count = SYNC, counter, bus.legs
    message.legs[:] = bus.leg
    return 1


@helper
def _parse_command(bus: Any, which: int, frame: Any, message: Any) -> int:
    if frame.length != bus.size[which]:
        return _reject(message, LENGTH)
    form, scale = integers_at(bus.form, bus.form_size), reals_at(bus.scale, 3)
    last = _command(
        frame.data, frame.length, bus.register[which], form, scale, bus.forces[which], message.force
    )
    if last < 0:
        return _reject(message, -last)
    counter = last & 0xFF
    message.counter = counter
    if bus.present == NO_SYNC or counter != bus.present & bus.mask:
        return _reject(message, NOT_PRESENT)
    first = bus.first[which]
    count = min(bus.forces[which], bus.legs - first)
    if count <= 0:
        return 0
    message.kind, message.mode, message.count = COMMAND, last >> 8, count
    for k in range(count):
        message.legs[k] = bus.leg[first + k]
    return 1


@pointed(record(END), INTEGER, INTEGER)
def parse(end: Any, frame_address: int, message_address: int) -> int:
    """Decode a SYNC or a command, see `LegsProtocol.parse`; FAILED for a CONFIG or an E-stop."""
    frame = frame_at(frame_address)
    if frame.flags & STRANGE or frame.bus >= end.buses:
        return 0
    bus = _bus_at(end.bus + frame.bus * _BUS)
    identifier = np.int64(frame.id)
    if identifier == end.sync_id:
        return _parse_sync(end, bus, frame, message_at(message_address))
    for which in range(bus.commands):
        if identifier == bus.id[which]:
            return _parse_command(bus, which, frame, message_at(message_address))
    if identifier == end.estop_id:
        return FAILED
    for leg in range(LEGS):
        if identifier == end.config_id[leg]:
            return FAILED
    return 0


@helper
def _measured(reading: Any, quantity: int, leg: int) -> float:
    return float(
        reading.length[leg] if quantity == 0 else reading.rate[leg] if quantity == 1 else reading.force[leg]
    )


@helper
def _feedback(reading: Any, leg: int, counter: int, end: Any, frame: Any) -> None:
    """Fill in one feedback; what exceeds its field saturates."""
    form = integers_at(end.form, FIELD + 3 * QUANTITIES)
    scale, identifiers = reals_at(end.scale, 3 * QUANTITIES), integers_at(end.identifiers, 2 * LEGS)
    word = np.empty(1, np.int64)
    size = form[FEEDBACK_SIZE]
    begin_sent(frame, identifiers[leg], size, end.feedback_flags, end.home[leg])
    data = frame.data
    for k in range(QUANTITIES):
        field = FIELD + 3 * k
        if form[field + 1] == 0:
            continue
        value = _measured(reading, k, leg)
        value = min(max(value, scale[QUANTITIES + k]), scale[2 * QUANTITIES + k])
        if not form[field + 2]:
            value = np.rint(value / scale[k])
        write(value, data, 0, form[field], form[field + 1], form[field + 2], word)
    data[form[LAST_AT]] = reading.state[leg] << 4 | counter
    data[size - 1] = register_after(data, 0, size - 1, identifiers[LEGS + leg]) ^ FINAL_XOR


@helper
def _no_number(reading: Any, form: Ints) -> bool:
    for leg in range(LEGS):
        for k in range(QUANTITIES):
            if form[FIELD + 3 * k + 1] and np.isnan(_measured(reading, k, leg)):
                return True
    return False


@pointed(record(END), INTEGER, INTEGER, INTEGER, INTEGER)
def answer(end: Any, sync_address: int, reading_address: int, into: int, senders: int) -> int:
    """Fill in the feedbacks to a SYNC and the leg of each, leg order on each bus; FAILED for a NaN.

    A drive answers on its own bus. On one bus all do.
    """
    sync, reading = message_at(sync_address), reading_at(reading_address)
    if _no_number(reading, integers_at(end.form, FIELD + 3 * QUANTITIES)):
        return FAILED
    asked = 0
    for k in range(sync.count):
        asked |= 1 << sync.legs[k]
    if not end.several:
        asked = (1 << LEGS) - 1
    legs = integers_at(senders, LEGS)
    count = 0
    for bus in range(end.buses):
        for leg in range(LEGS):
            if end.home[leg] == bus and asked >> leg & 1:
                _feedback(reading, leg, sync.counter & 0xF, end, frame_at(into + count * _FRAME))
                legs[count] = leg
                count += 1
    return count


@pointed(record(END), INTEGER, INTEGER, INTEGER, INTEGER, INTEGER, INTEGER, INTEGER)
def report(
    end: Any, leg: int, state: int, fault: int, watchdog_ns: int, reaction: int, _due: int, into: int
) -> int:
    """Fill in one drive's status; FAILED for a watchdog that no CONFIG could have set."""
    checksum = 0
    if watchdog_ns >= 0:
        watchdog = np.int64(np.rint(watchdog_ns * 1e-9 / end.watchdog_s))
        if not 1 <= watchdog < 1 << 32:
            return FAILED
        said = np.empty(_CONFIG_SIZE + 6, np.uint8)
        for k in range(2):
            said[k] = end.config_id[leg] >> 8 * k & 0xFF
        for k in range(4):
            said[2 + k] = watchdog >> 8 * k & 0xFF
            said[2 + _CONFIG_SIZE + k] = end.rated_mN >> 8 * k & 0xFF
        said[6], said[7], said[8] = reaction, end.slot[leg] + 1, end.version
        checksum = check_of(said, 0, said.size, START_16, 2)
    frame = frame_at(into)
    identifiers = integers_at(end.identifiers, 4 * LEGS)
    size = integers_at(end.form, STATUS_SIZE + 1)[STATUS_SIZE]
    begin_sent(frame, identifiers[_STATUS + leg], size, end.status_flags, end.home[leg])
    data = frame.data
    data[0], data[1], data[2], data[3] = state, fault, checksum & 0xFF, checksum >> 8
    data[size - 1] = register_after(data, 0, size - 1, identifiers[_STATUS + LEGS + leg]) ^ FINAL_XOR
    return 1


@pointed(record(END), INTEGER, INTEGER, INTEGER)
def fresh(end: Any, frame_address: int, tick: int, since_ns: int) -> int:
    """Return the leg, from 1 on, of an intact feedback to this tick's SYNC on its own bus; else 0."""
    frame = frame_at(frame_address)
    identifiers = integers_at(end.identifiers, 2 * LEGS)
    identifier = np.int64(frame.id)
    for leg in range(LEGS):
        if identifier == identifiers[leg]:
            size = integers_at(end.form, FEEDBACK_SIZE + 1)[FEEDBACK_SIZE]
            good = frame.bus == end.home[leg] and not frame.flags & STRANGE and frame.length == size
            good = good and (tick - np.int64(frame.data[end.counter_at])) & 0xF == 0
            good = good and frame.t_ns >= since_ns
            return leg + 1 if good and _whole(frame.data, size, identifiers[LEGS + leg]) else 0
    return 0


@pointed(record(END), INTEGER)
def addressed(end: Any, frame_address: int) -> int:
    """Return which legs a frame is for, bit i: leg i. Only a CONFIG is for one."""
    frame = frame_at(frame_address)
    identifier, legs = np.int64(frame.id), 0
    for leg in range(LEGS):
        if identifier == end.config_id[leg]:
            return 1 << leg if not end.several or frame.bus == end.home[leg] else 0
        if not end.several or frame.bus == end.home[leg]:
            legs |= 1 << leg
    return legs
