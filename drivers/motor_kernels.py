"""The controller's end of single-motor drives, compiled: one record, which every family shares.

A family gives `hear(ear, frame, heard)`, which fills HEARD with what one frame of a drive says and returns
whether it says anything, and the frames that its drives are sent.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from drivers.arrays import Bytes
from drivers.compiled.compiler import INTEGER, helper, record
from drivers.compiled.pointed import FAILED, call, integers_at, pointed, reals_at, record_at, records_at
from drivers.frame_array import FRAME
from drivers.frame_pointers import begin_measurement, code, frames_at, whole
from drivers.signals import LEGS, DriveFault, DriveMode, DriveState, Foreign
from drivers.tick_columns import TICK, part
from drivers.transmission import FIELDS, loss_of

OWN_CODE = 0x100
"""Added to a fault code of a family, so that none is taken for a DriveFault."""
RETRY_TICKS = 10
"""After which a request without an answer is repeated."""
RESTART_TICKS = 20
"""A drive that was silent for so long may have restarted: it is set up again."""
MOST_EXCHANGES = 8
"""Of the start-up dialogue of one drive."""
HEARD = np.dtype(
    [
        ("leg", "<i8"),
        ("has", "<i8"),  # bits of BROKEN to ANSWER
        ("turns", "<f8"),
        ("speed", "<f8"),  # turns/s
        ("torque", "<f8"),  # N m
        ("power", "<i8"),  # DriveState OFF (disabled), RUN (enabled) or FAULT
        ("fault", "<i8"),  # DriveFault, or OWN_CODE and the family's code
        ("register", "<i8"),
        ("value", "<f8"),
    ]
)
"""What one frame of a drive says; `register` and `value` of an answer of the start-up dialogue."""
BROKEN, FOREIGN, MOTION, FEEDBACK, TORQUE, POWER, ANSWER = (1 << k for k in range(7))
EAR = np.dtype(
    [
        ("nodes", "<i8", (LEGS,)),
        ("replies", "<i8", (LEGS,)),  # identifiers of the drives' answers
        ("host", "<i8"),
        ("position", "<f8"),  # ends of symmetric fields, rad, rad/s, N m
        ("velocity", "<f8"),
        ("torque", "<f8"),
        ("shortest", "<i8"),  # bytes of an answer
        ("longest", "<i8"),
        ("clamps", "<i8"),
        ("faults", "<i8"),  # bit k: the drives have a fault of code k
        ("silence", "<i8"),  # fault code of a drive's own watchdog; -1: none
        ("stopped", "<i8"),  # of an emergency stop
        ("registers", "<i8"),  # 1: it answers readings of registers
        # what all families need
        ("hear", "<i8"),  # address of the function
        ("shift", "<i8"),  # where an identifier has the number of a drive, and its bits
        ("mask", "<i8"),
        ("requests", "<i8"),  # identifier of requests that name a drive in their data; -1: none
        ("buses", "<i8"),  # how many; frames of others are not ours
        ("bus_of", "<i8", (LEGS,)),
        ("heard", "<f8", (HEARD.itemsize // 8,)),  # scratch: an element of HEARD
    ]
)
"""What a family's `hear` works on: each family uses what it needs."""
IDLE, CLEAR, ENABLE, DRIVE, PREPARE = range(5)
"""Rows of the frames to the drives, by what they ask for; the torque is put into those of DRIVE."""
KEEPS, FALLS, PREPARES = range(3)
"""Rules of what an enabled or disabled drive is sent, see `row_of`."""
IN_IDENTIFIER = -1
SIGNED = -16
"""Bits of a signed torque, which is little-endian."""
MOTORS = np.dtype(
    [
        # the family
        ("ear", "<i8"),  # address of EAR
        ("frames", "<i8"),  # address of rows of six elements of FRAME
        ("rule", "<i8"),
        ("clears", "<i8"),  # 1: a drive in fault is sent CLEAR while RESET is asked for
        ("torque_at", "<i8"),  # first byte of the torque, or IN_IDENTIFIER
        ("torque_bits", "<i8"),  # 32: a single; -16: a signed number, little-endian
        ("torque_end", "<f8"),  # N m, of the field; of a signed number, of the code -32768
        ("torque_limit", "<f8"),  # N m
        ("unasked", "<i8"),  # 1: drives send readings by a timer, too
        ("reports", "<i8"),  # 1: drives say whether they are enabled
        *FIELDS,
        # start-up dialogue
        ("exchanges", "<i8", (LEGS,)),  # how many each drive has to confirm
        ("registers", "<i8", (LEGS, MOST_EXCHANGES)),
        ("values", "<f8", (LEGS, MOST_EXCHANGES)),
        # the dialogue
        ("mode", "<i8"),
        ("torque", "<f8", (LEGS,)),  # N m, of the last command
        ("rate", "<f8", (LEGS,)),  # m/s, last read: it decides the losses
        ("power", "<i8", (LEGS,)),  # DriveState OFF, RUN or FAULT, as last heard; BOOT: not yet
        ("ran", "<i8", (LEGS,)),  # 1: enabled since RUN is asked for
        ("done", "<i8", (LEGS,)),  # 1 of a drive that is heard, and 1 an exchange that it has confirmed
        ("asked", "<i8", (LEGS,)),  # tick of the last request
        ("said", "<i8", (LEGS,)),  # tick in which it last said whether it is enabled
        ("owed", "<i8", (LEGS,)),  # polls that a drive that is heard has not answered, RESTART_TICKS at most
        ("patience_ticks", "<i8"),  # after which a drive that does not say so is in BOOT
        ("read", "<f8", (LEGS,)),  # what the last answer held that was not the right one
        ("has_read", "<i8", (LEGS,)),
        ("scratch", "<f8", (1 + 2 * LEGS, HEARD.itemsize // 8)),  # elements of HEARD
    ]
)
"""The controller's end of six single-motor drives."""
_MOTORS = record(MOTORS)
_TICK = record(TICK, "tick", *part("measurement"))
heard_at = records_at(record(HEARD))
ear_at = record_at(record(EAR))
hearing = pointed(record(EAR), record(FRAME), record(HEARD))
"""What compiles a family's `hear`."""
_FRAME_BYTES = FRAME.itemsize


# what a family's `hear` uses


@helper
def says(heard: Any, leg: int, has: int) -> int:
    """Begin what a frame says; return 1."""
    heard.leg, heard.has = leg, has
    heard.turns = heard.speed = heard.torque = heard.value = 0.0
    heard.power = heard.fault = heard.register = 0
    return 1


@helper
def powers(ear: Any, heard: Any, code: int, enabled: bool) -> int:
    """Say whether a drive is enabled, or in a fault of a code that is not 0; return 1."""
    heard.has |= POWER
    heard.power = DriveState.RUN.value if enabled else DriveState.OFF.value
    if code:
        heard.power = DriveState.FAULT.value
    if code in (ear.silence, ear.stopped):
        heard.fault = DriveFault.WATCHDOG.value if code == ear.silence else DriveFault.ESTOP.value
    elif code:
        heard.fault = OWN_CODE + code
    return 1


@helper
def single(data: Any, at: int) -> float:
    """Return the single of four bytes, little-endian."""
    word = np.empty(1, np.uint32)
    word[0] = whole(data, at)
    return float(word.view(np.float32)[0])


# decoding


@helper
def wire_state(power: int, mode: int, set_up: bool, ran: bool) -> int:
    """Return the DriveState of a drive that says only whether it is enabled; see `drivers.motors`."""
    if power in (DriveState.FAULT, DriveState.RUN):
        return power
    if not set_up or (ran and mode == DriveMode.RUN):
        return DriveState.BOOT.value
    return DriveState.READY.value if mode in (DriveMode.READY, DriveMode.RUN) else DriveState.OFF.value


@helper
def _confirm(m: Any, heard: Any) -> None:
    """Take the answer to an exchange of the start-up dialogue."""
    leg = heard.leg
    step = m.done[leg] - 1
    if not 0 <= step < m.exchanges[leg] or heard.register != m.registers[leg, step]:
        return
    if np.float32(heard.value) != np.float32(m.values[leg, step]):
        m.read[leg], m.has_read[leg] = heard.value, 1
        return
    m.done[leg], m.asked[leg] = step + 2, -RETRY_TICKS
    m.read[leg], m.has_read[leg] = 0.0, 0


@helper
def _measure(m: Any, here: int, late: int, tick: Any) -> None:
    """Fill in what the answers of this tick say of the legs: bits of those in time, and of late ones."""
    kept = heard_at(np.int64(m.scratch.ctypes.data), 1 + 2 * LEGS)
    for leg in range(LEGS):
        in_time = here >> leg & 1
        if in_time or late >> leg & 1:
            heard = kept[1 + leg] if in_time else kept[1 + LEGS + leg]
            m.done[leg] = max(m.done[leg], 1)
            if not heard.has & MOTION:
                tick.blind[leg] = 1
            else:
                rate = m.m_per_turn[leg] * heard.speed
                tick.length[leg] = m.offset[leg] + m.m_per_turn[leg] * heard.turns
                tick.rate[leg], tick.age[leg] = rate, 0
                if heard.has & TORQUE:
                    torque = heard.torque + 0.0  # -0 becomes 0: recorded logs have its sign
                    lossless = m.N_per_Nm[leg] * torque
                    loss = loss_of(lossless, rate, m.driving[leg], m.back_driving[leg], m.full_loss_m_s)
                    tick.drive_force[leg] = lossless / loss
        power = m.power[leg]
        set_up = m.done[leg] > m.exchanges[leg] and power != DriveState.BOOT
        tick.drive_state[leg] = wire_state(power, m.mode, set_up, m.ran[leg] != 0)
        m.ran[leg] = m.mode == DriveMode.RUN and (m.ran[leg] != 0 or power == DriveState.RUN)
    m.rate[:] = tick.rate


@helper
def _forget(m: Any, tick: Any) -> None:
    """Forget the set-up of drives that were silent for long, and the state of those that tell none."""
    for leg in range(LEGS):
        if tick.age[leg] > RESTART_TICKS:
            m.done[leg] = 0
        if tick.tick - m.said[leg] > m.patience_ticks:
            m.power[leg] = DriveState.BOOT.value


@helper
def _take(m: Any, heard: Any, early: bool, last: Any, tick: Any) -> int:
    """Take what a drive says; return the place at which it is kept, 0 where it is not."""
    leg = heard.leg
    feedback = heard.has & FEEDBACK
    if feedback and early:
        m.owed[leg] -= 1
        if not m.unasked and m.done[leg] > m.exchanges[leg]:
            tick.rejected += 1
        measures = last.age[leg] > 0 and last.tick >= 0
        return 1 + LEGS + int(leg) if measures else 0
    if heard.has & POWER or not m.reports:
        asked = DriveState.RUN.value if m.mode == DriveMode.RUN else DriveState.OFF.value
        m.power[leg] = heard.power if heard.has & POWER else asked
        tick.drive_fault[leg] = heard.fault
        m.said[leg] = tick.tick
    if not feedback:
        return 0
    m.owed[leg] -= 1
    return 1 + int(leg)


@helper
def _set_up(m: Any) -> int:
    legs = 0
    for leg in range(LEGS):
        legs |= int(m.done[leg] > m.exchanges[leg] and m.power[leg] != DriveState.BOOT) << leg
    return legs


@pointed(_MOTORS, INTEGER, INTEGER, INTEGER, _TICK, _TICK)
def decode(m: Any, frames: int, count: int, since_ns: int, last: Any, tick: Any) -> int:
    """Fill the measurement of a tick, see `ControllerEnd.take`.

    frames: address of `count` elements of FRAME. Returns 1 where other drives are set up than before, else 0.
    """
    begin_measurement(last, tick)
    set_up = _set_up(m)
    for leg in range(LEGS):
        m.owed[leg] = m.owed[leg] + 1 if m.done[leg] else 2
    power, said = m.power.copy(), m.said.copy()
    at = np.int64(m.scratch.ctypes.data)
    heard, ear = heard_at(at, 1)[0], ear_at(m.ear)
    received = frames_at(frames, count)
    taken = 0
    for n in range(count):
        bus = int(received[n].bus)
        if bus >= ear.buses:
            tick.rejected += ear.buses > 1
            continue
        if not call(ear.hear, (m.ear, frames + n * _FRAME_BYTES, at)):
            continue
        leg, has = heard.leg, heard.has
        early = received[n].t_ns < since_ns
        if not has & FOREIGN and (has & BROKEN or bus != ear.bus_of[leg]):
            tick.rejected += 1
        elif has & FOREIGN:
            tick.foreign = Foreign.COMMAND.value
        elif has & ANSWER:
            _confirm(m, heard)
        elif has & FEEDBACK and not early and taken >> leg & 1 and m.owed[leg] <= 0 and not m.unasked:
            tick.doubled |= int(np.any(m.scratch[1 + leg] != m.scratch[0])) << leg
        else:
            place = _take(m, heard, early, last, tick)
            if place:
                m.scratch[place] = m.scratch[0]
                taken |= 1 << (place - 1)
    changed = taken != 0
    for leg in range(LEGS):
        m.owed[leg] = min(max(m.owed[leg], 0), RESTART_TICKS) if m.done[leg] > 0 else 0
        changed = changed or m.power[leg] != power[leg] or m.said[leg] != said[leg]
    if changed:
        here, late = taken & ((1 << LEGS) - 1), taken >> LEGS
        _measure(m, here, late, tick)
        for leg in range(LEGS):
            if late & ~here & 1 << leg and tick.age[leg] == 0:
                tick.age[leg] = tick.tick - last.tick
    tick.counted_age[:] = tick.age
    _forget(m, tick)
    return int(_set_up(m) != set_up)


# commands


@helper
def remember(m: Any, mode: int, force_at: int) -> bool:
    """Remember one tick's command; tell whether its forces, (6,) N at an address, fit."""
    force = reals_at(force_at, LEGS)
    torque = np.empty(LEGS)
    for leg in range(LEGS):
        if not np.isfinite(force[leg]):
            return False
        loss = loss_of(force[leg], m.rate[leg], m.driving[leg], m.back_driving[leg], m.full_loss_m_s)
        torque[leg] = loss * force[leg] / m.N_per_Nm[leg]
        if abs(torque[leg]) > m.torque_limit * (1.0 + 1e-9):
            return False
    if mode != m.mode:
        m.ran[:] = 0
    m.mode = mode
    m.torque[:] = torque
    return True


@pointed(_MOTORS, INTEGER, INTEGER, INTEGER, INTEGER, INTEGER)
def command(m: Any, _number: int, mode: int, _stop: int, force_at: int, _into: int) -> int:
    """Remember one tick's command for the next polls; return 0 frames, or FAILED: a force does not fit."""
    return 0 if remember(m, mode, force_at) else FAILED


@helper
def row_of(m: Any, leg: int) -> int:
    """Return which row of frames has what a drive is sent in this tick, besides what enables an axis."""
    power, ran = m.power[leg], m.ran[leg]
    if m.mode == DriveMode.RUN:
        if m.rule == FALLS:
            return IDLE if ran and power == DriveState.OFF else DRIVE
        return ENABLE if m.rule == KEEPS and not ran and power != DriveState.RUN else DRIVE
    if m.rule == PREPARES:
        return PREPARE if m.mode == DriveMode.READY and power == DriveState.OFF else IDLE
    return CLEAR if m.clears and m.mode == DriveMode.RESET and power == DriveState.FAULT else IDLE


@helper
def put_single(value: float, data: Bytes, at: int) -> None:
    """Put a single into four bytes, little-endian."""
    word = np.empty(1, np.float32)
    word[0] = value
    raw = int(word.view(np.uint32)[0])
    for k in range(4):
        data[at + k] = raw >> 8 * k & 0xFF


@helper
def signed_code(torque: float, end: float) -> int:
    """Return the code of a torque in a signed field of 16 bits: truncated towards 0, saturated."""
    return int(min(max(torque / end * 32768.0, -32768.0), 32767.0))


@helper
def send(m: Any, row: int, leg: int, into: int) -> None:
    """Put the frame of a row for a leg at an address."""
    words = _FRAME_BYTES // 8
    integers_at(into, words)[:] = integers_at(m.frames + (row * LEGS + leg) * _FRAME_BYTES, words)
    frame = frames_at(into, 1)[0]
    frame.bus = ear_at(m.ear).bus_of[leg]
    if row != DRIVE:
        return
    at, end = m.torque_at, m.torque_end
    if m.torque_bits == 32:
        put_single(m.torque[leg], frame.data, at)
        return
    if m.torque_bits == SIGNED:
        number = signed_code(m.torque[leg], end)
        frame.data[at], frame.data[at + 1] = number & 0xFF, number >> 8 & 0xFF
        return
    number = code(m.torque[leg], -end, end, m.torque_bits)
    if at == IN_IDENTIFIER:
        frame.id |= number << 8
    else:
        frame.data[at] |= number >> 8
        frame.data[at + 1] = number & 0xFF


@pointed(_MOTORS, INTEGER, INTEGER)
def begin(m: Any, _number: int, into: int) -> int:
    """Put what each drive is sent in this tick into six elements of FRAME at an address."""
    for leg in range(LEGS):
        send(m, row_of(m, leg), leg, into + leg * _FRAME_BYTES)
    return LEGS
