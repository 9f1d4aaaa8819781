"""The controller's end of drives with one motor per node, in kernels that share one record.

A family supplies `hear(ear, frame, heard)`, which decodes one frame of a drive into HEARD and returns 0 for a
frame without content. `ear` has the family's tables (EAR). The family also supplies the frames to its drives.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from drivers.compiled.compiler import INTEGER, helper, record
from drivers.compiled.pointed import FAILED, call, integers_at, pointed, reals_at, record_at, records_at
from drivers.frame_array import FRAME
from drivers.frame_pointers import begin_measurement, code, frames_at, now_owed, still_owed, whole
from drivers.motor_readings import joins
from drivers.sensing.kernels import put_real, put_single, rows_at
from drivers.signals import LEGS, DriveFault, DriveMode, DriveState, Foreign
from drivers.tick_columns import TICK, part
from drivers.transmission import FIELDS, loss_of

OWN_CODE = 0x100
"""Offset of a family's fault codes, which keeps them apart from DriveFault."""
RETRY_TICKS = 10
"""Ticks after which a request without an answer is repeated."""
RESTART_TICKS = 20
"""A drive that was silent for this many ticks may have restarted: it is set up again."""
MOST_EXCHANGES = 8
"""Most exchanges of one drive's start-up dialogue."""
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
        ("part", "<i8"),  # number of the message, where several make a reading
    ]
)
"""Content of one frame of a drive; `register` and `value`: an answer of the start-up dialogue; in a BROKEN
frame they are a refused read, with value NaN."""
BROKEN, FOREIGN, MOTION, FEEDBACK, TORQUE, POWER, ANSWER = (1 << k for k in range(7))
EAR = np.dtype(
    [
        ("nodes", "<i8", (LEGS,)),
        ("replies", "<i8", (LEGS,)),  # identifiers of the drives' answers
        ("host", "<i8"),
        ("position", "<f8"),  # largest values of symmetric fields, rad, rad/s, N m
        ("velocity", "<f8"),
        ("torque", "<f8"),
        ("shortest", "<i8"),  # bytes of an answer
        ("longest", "<i8"),
        ("clamps", "<i8"),
        ("faults", "<i8"),  # bit k: the drives have a fault of code k
        ("silence", "<i8"),  # fault code of a drive's own watchdog; -1: none
        ("stopped", "<i8"),  # fault code of an emergency stop; -1: none
        ("registers", "<i8"),  # 1: the drives answer reads of registers
        ("table", "<i8"),  # address of the mapping of a DBC
        ("parts", "<i8"),  # messages of a reading that a timer sends; 0: readings answer a poll
        ("flags", "<i8"),  # FD and BRS, if the frames have them
        # used by all families
        ("hear", "<i8"),  # address of that function
        ("shift", "<i8"),  # position and mask of the node number in an identifier
        ("mask", "<i8"),
        ("requests", "<i8"),  # identifier of requests with the node number in their data; -1: none
        ("buses", "<i8"),  # number of buses; frames of others are ignored
        ("bus_of", "<i8", (LEGS,)),
        ("heard", "<f8", (HEARD.itemsize // 8,)),  # scratch: a HEARD record
    ]
)
"""Tables of a family's `hear`: each family uses the fields that it needs."""
IDLE, CLEAR, ENABLE, DRIVE, PREPARE = range(5)
"""Rows of the frames to the drives, by purpose; the torque is put into those of DRIVE."""
KEEPS, FALLS, PREPARES = range(3)
"""Rules for the frames to an enabled or disabled drive, see `row_of`."""
IN_IDENTIFIER = -1
SIGNED = -16
"""Bits of a signed torque, little-endian."""
MAPPED = -2
"""Bits of a torque whose field is in the mapping of a DBC."""
MOTORS = np.dtype(
    [
        # the family
        ("ear", "<i8"),  # address of EAR
        ("frames", "<i8"),  # address of rows of six FRAME records
        ("rule", "<i8"),
        ("clears", "<i8"),  # 1: a drive in fault gets CLEAR while RESET is requested
        ("torque_at", "<i8"),  # first byte of the torque, IN_IDENTIFIER, or with MAPPED address of its ROW
        ("torque_bits", "<i8"),  # 32: a single; -16: a signed number, little-endian
        ("torque_end", "<f8"),  # N m: largest value of the field; of a signed one, that of code -32768
        ("torque_limit", "<f8"),  # N m
        ("unasked", "<i8"),  # 1: drives also send unrequested readings
        ("reports", "<i8"),  # 1: drives report whether they are enabled
        # readings that a timer sends
        ("parts", "<i8"),  # bits of the messages of one
        ("gap_ns", "<i8"),  # longest time between them
        ("period_ns", "<i8"),  # period of the loop: older readings are late; 0 with polls
        *FIELDS,
        # start-up dialogue
        ("exchanges", "<i8", (LEGS,)),  # number that each drive has to confirm
        ("registers", "<i8", (LEGS, MOST_EXCHANGES)),
        ("values", "<f8", (LEGS, MOST_EXCHANGES)),
        # the dialogue
        ("mode", "<i8"),
        ("torque", "<f8", (LEGS,)),  # N m, of the last command
        ("rate", "<f8", (LEGS,)),  # m/s, last reading: it decides the losses
        ("power", "<i8", (LEGS,)),  # DriveState OFF, RUN or FAULT of the last report; BOOT: none yet
        ("ran", "<i8", (LEGS,)),  # 1: enabled since the request of RUN
        ("done", "<i8", (LEGS,)),  # 1 for an answer, and 1 for each exchange confirmed
        ("asked", "<i8", (LEGS,)),  # tick of the last request
        ("said", "<i8", (LEGS,)),  # tick of its last report whether it is enabled
        ("owed", "<i8", (LEGS,)),  # polls that it has not answered, see `now_owed`
        ("patience_ticks", "<i8"),  # longest time without such a report: then BOOT
        ("read", "<f8", (LEGS,)),  # value of the last answer, if it was wrong
        ("has_read", "<i8", (LEGS,)),
        ("got", "<i8", (LEGS,)),  # bits of the received messages of a reading
        ("began_ns", "<i8", (LEGS,)),  # arrival of the first
        ("halves", "<f8", (LEGS, HEARD.itemsize // 8)),  # HEARD records of the received messages
        ("scratch", "<f8", (1 + 2 * LEGS, HEARD.itemsize // 8)),  # HEARD records
    ]
)
"""Record of the controller's end of six single-motor drives."""
_MOTORS = record(MOTORS)
_TICK = record(TICK, "tick", *part("measurement"))
heard_at = records_at(record(HEARD))
ear_at = record_at(record(EAR))
hearing = pointed(record(EAR), record(FRAME), record(HEARD))
"""Decorator that compiles a family's `hear`."""
_FRAME_BYTES = FRAME.itemsize


# helpers for a family's `hear`


@helper
def says(heard: Any, leg: int, has: int) -> int:
    """Initialize the content of a decoded frame (HEARD): its leg and bits of what it has; returns 1."""
    heard.leg, heard.has = leg, has
    heard.turns = heard.speed = heard.torque = heard.value = 0.0
    heard.power = heard.fault = heard.register = heard.part = 0
    return 1


@helper
def powers(ear: Any, heard: Any, code: int, enabled: bool) -> int:
    """Set in `heard` that a drive is enabled, disabled or, with a code other than 0, in fault; returns 1."""
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
    """Float32 in four bytes of data from index `at`, little-endian."""
    word = np.empty(1, np.uint32)
    word[0] = whole(data, at)
    return float(word.view(np.float32)[0])


# decoding


@helper
def wire_state(power: int, mode: int, set_up: bool, ran: bool) -> int:
    """DriveState of a drive that reports only whether it is enabled, by the rules of `drivers.motors`."""
    if power in (DriveState.FAULT, DriveState.RUN):
        return power
    if not set_up or (ran and mode == DriveMode.RUN):
        return DriveState.BOOT.value
    return DriveState.READY.value if mode in (DriveMode.READY, DriveMode.RUN) else DriveState.OFF.value


@helper
def _confirm(m: Any, heard: Any) -> None:
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
    for leg in range(LEGS):
        if tick.age[leg] > RESTART_TICKS:
            m.done[leg] = 0
        if tick.tick - m.said[leg] > m.patience_ticks:
            m.power[leg] = DriveState.BOOT.value


@helper
def _take(m: Any, heard: Any, early: bool, last: Any, tick: Any) -> int:
    """Process a drive's decoded frame; returns the row of `scratch` that is to keep it, 0: none."""
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
    """Fill the measurement of a tick as described at `ControllerEnd.take`.

    frames: address of `count` FRAME records. Returns 1 if the set of configured drives has changed, else
    0.
    """
    begin_measurement(last, tick)
    set_up = _set_up(m)
    for leg in range(LEGS):
        m.owed[leg] = now_owed(m.owed[leg], m.done[leg] != 0)
    power, said = m.power.copy(), m.said.copy()
    at = np.int64(m.scratch.ctypes.data)
    heard, ear = heard_at(at, 1)[0], ear_at(m.ear)
    received, halves = frames_at(frames, count), heard_at(np.int64(m.halves.ctypes.data), LEGS)
    taken = 0
    for n in range(count):
        bus = int(received[n].bus)
        if bus >= ear.buses:
            tick.rejected += ear.buses > 1
            continue
        if not call(ear.hear, (m.ear, frames + n * _FRAME_BYTES, at)):
            continue
        leg, has = heard.leg, heard.has
        early = received[n].t_ns < since_ns - m.period_ns
        if not has & FOREIGN and (has & BROKEN or bus != ear.bus_of[leg]):
            tick.rejected += 1
            if bus == ear.bus_of[leg]:
                _confirm(m, heard)
        elif has & FOREIGN:
            tick.foreign = Foreign.COMMAND.value
        elif has & ANSWER:
            _confirm(m, heard)
        elif has & FEEDBACK and not early and taken >> leg & 1 and m.owed[leg] <= 0 and not m.unasked:
            tick.doubled |= int(np.any(m.scratch[1 + leg] != m.scratch[0])) << leg
        elif m.parts == 0 or joins(m, heard, halves[leg], received[n].t_ns, MOTION):
            place = _take(m, heard, early, last, tick)
            if place:
                m.scratch[place] = m.scratch[0]
                taken |= 1 << (place - 1)
    changed = taken != 0
    for leg in range(LEGS):
        m.owed[leg] = still_owed(m.owed[leg], m.done[leg] > 0)
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
    """Store one tick's mode and motor torques; False if a leg force, (6,) N at an address, does not fit."""
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
    """Store one tick's command for the next polls; returns 0 frames, or FAILED if a force does not fit."""
    return 0 if remember(m, mode, force_at) else FAILED


@helper
def row_of(m: Any, leg: int) -> int:
    """Row (purpose) of the frame that a drive gets in this tick: IDLE, CLEAR, ENABLE, DRIVE or PREPARE."""
    power, ran = m.power[leg], m.ran[leg]
    if m.mode == DriveMode.RUN:
        if m.rule == FALLS:
            return IDLE if ran and power == DriveState.OFF else DRIVE
        return ENABLE if m.rule == KEEPS and not ran and power != DriveState.RUN else DRIVE
    if m.rule == PREPARES:
        return PREPARE if m.mode == DriveMode.READY and power == DriveState.OFF else IDLE
    return CLEAR if m.clears and m.mode == DriveMode.RESET and power == DriveState.FAULT else IDLE


@helper
def signed_code(torque: float, end: float) -> int:
    """Code of a torque (N m, field end `end`) in a signed 16-bit field: truncated to 0, saturated."""
    return int(min(max(torque / end * 32768.0, -32768.0), 32767.0))


@helper
def send(m: Any, row: int, leg: int, into: int) -> None:
    """Write the frame of purpose `row` for a leg to address `into`; a DRIVE frame gets the torque."""
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
    if m.torque_bits == MAPPED:
        put_real(rows_at(m.torque_at, 1)[0], 0, m.torque[leg], frame.data)
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
    """Write each drive's poll of this tick to six FRAME records at address `into`; returns 6."""
    for leg in range(LEGS):
        send(m, row_of(m, leg), leg, into + leg * _FRAME_BYTES)
    return LEGS
