"""The controller's end of six CiA 402 drives, compiled: one record, which has the dialogue."""

from __future__ import annotations

from typing import Any

import numpy as np

from drivers.cia402 import objects as o
from drivers.cia402 import states as s
from drivers.compiled.compiler import INTEGER, helper, record
from drivers.compiled.pointed import FAILED, pointed, reals_at
from drivers.frame_pointers import begin_measurement, begin_sent, frames_at, place_of, signed, whole
from drivers.protocol import STRANGE
from drivers.signals import LEGS, DriveFault, DriveMode, DriveState, Foreign
from drivers.tick_columns import TICK, part
from drivers.transmission import FIELDS, loss_of

OLDEST = 50
"""Ticks after which a difference of lengths says nothing of the rate."""
STRAYING = 8
"""Ticks after a drive was missed within which what it still owes may come: a stall shifts answers."""
SHORTEST = 0.5
"""Periods; a stall leaves shorter steps, over which the steps of the encoder make too rough a rate."""
MOST_PERMILLE = 32_767
MOST_STEPS = 96
"""Of a plan."""
OPTIONAL = 1 << 32
"""Bit of a mask: a drive may lack the object."""
NOT_ASKED = -1
DRIVES = np.dtype(
    [
        ("nodes", "<i8", (LEGS,)),
        ("controller", "<i8"),  # its node
        ("velocity", "<i8"),  # 1: it comes in TPDO2
        ("buses", "<i8"),  # how many; frames of others are not ours
        ("bus_of", "<i8", (LEGS,)),
        ("beat", "<i8"),  # ticks from one heartbeat of ours to the next
        ("lossless", "<i8"),
        *((name, "<f8") for name in ("period_s", "permille_Nm")),
        *((name, "<f8", (LEGS,)) for name in ("m_per_count", "N_per_permille", "permille_per_N")),
        *FIELDS,
        # the start-up dialogue
        ("patience", "<i8"),  # ticks after which a request is repeated
        ("steps", "<i8", (LEGS,)),  # of each plan
        ("requests", "<i8", (LEGS, MOST_STEPS)),  # data of an SDO request; of NMT the command and the node
        ("values", "<i8", (LEGS, MOST_STEPS)),  # that are written or expected
        ("masks", "<i8", (LEGS, MOST_STEPS)),  # bits of it that are compared, and OPTIONAL
        ("at", "<i8", (LEGS,)),  # step of its plan that a drive is at
        ("asked", "<i8", (LEGS,)),  # tick of the request that is not answered
        ("tries", "<i8", (LEGS,)),  # how often that has been sent
        ("refused", "<i8", (LEGS,)),  # step, from 1 on, that a drive has refused or reads otherwise; 0: none
        ("abort", "<i8", (LEGS,)),  # its abort code; 0: it reads otherwise
        ("read", "<i8", (LEGS,)),  # and what
        # what a tick needs of those before
        ("states", "<i8", (LEGS,)),
        ("mode", "<i8"),  # commanded last
        ("stopped", "<i8"),  # bit i: drive i has been stopped quickly, and no RESET since
        ("resets", "<i8"),  # bit i: drive i could not hear a RESET, and gets one when it is set up
        ("rate", "<f8", (LEGS,)),
        ("owed", "<i8", (2 * LEGS,)),  # TPDO1, then TPDO2 of each drive to earlier SYNCs, that have not come
        ("missed", "<i8", (LEGS,)),  # last tick in which a drive was not heard
        # the step from one length of a leg to the next
        ("mean", "<f8", (LEGS,)),  # rate, m/s
        ("T", "<f8", (LEGS,)),  # s, between the two; 0: there is one length only
        ("latched_ns", "<i8", (LEGS,)),  # when the last one was latched, by the clock
        ("length", "<f8", (LEGS,)),  # that one, m
        ("has_length", "<i8", (LEGS,)),
        # scratch: TPDO1, then TPDO2 of a tick, their bytes as one number
        ("held", "<i8", (2 * LEGS,)),
        ("has", "<i8", (2 * LEGS,)),
        ("late", "<i8", (2 * LEGS,)),
    ]
)
"""The controller's end of six drives."""
_PLACE_BYTES, _SPEED_BYTES, _EMERGENCY_BYTES, _SDO_BYTES = 8, 4, 8, 8
_DRIVES = record(DRIVES)
_TICK = record(TICK, "tick", "t_ns", "lateness_ns", "latch_ns", *part("measurement"))
_STATE_OF = np.array(s.STATE_OF)
_DRIVE_STATE = np.array(s.DRIVE_STATE, np.int64)
_NODE, _ALL_BITS = 0x7F, 0xFFFF_FFFF
_WHY = o.ERROR_CODE[0] | o.ERROR_CODE[1] << 16
_ALL = (1 << LEGS) - 1
FROM_DRIVES = o.EMCY_ID, *o.TPDO_ID, o.SDO_REPLY_ID, o.HEARTBEAT_ID
_TPDO1, _TPDO2, _RPDO = o.TPDO_ID[0], o.TPDO_ID[1], o.RPDO_ID[0]


@helper
def difference(c: Any, leg: int, length: float, latched_ns: int, rate: float) -> float:
    """Return the rate, m/s, at the end of a step from the last two mean rates; keep what the next one needs.

    dq = d1 + (d1 - d0) T1 / (T1 + T0), the slope at the end of the parabola through the last three lengths:
    the mean rate d1 of the step alone is that of T1 / 2 ago. T from SYNC to SYNC as the bus carried them: at
    400 Hz one that is 25 us late moves a leg by 1 % of its step. A step shorter than SHORTEST periods leaves
    the rate as it was read last, m/s, and is part of the next one; after OLDEST periods the rate begins at 0.
    length: m; latched_ns: when it was.
    """
    T1 = 1e-9 * (latched_ns - c.latched_ns[leg])
    goes_on = c.has_length[leg] != 0 and OLDEST * c.period_s >= T1
    if goes_on and SHORTEST * c.period_s > T1:
        return rate
    d0, T0, d1, found = c.mean[leg], c.T[leg], 0.0, 0.0
    if goes_on:
        d1 = (length - c.length[leg]) / T1
        found = d1 + ((d1 - d0) * T1 / (T1 + T0) if T0 != 0.0 else 0.0)
    c.mean[leg], c.T[leg], c.has_length[leg] = d1, T1 if goes_on else 0.0, 1
    c.latched_ns[leg], c.length[leg] = latched_ns, length
    return found


@helper
def _take(c: Any, slot: int, leg: int, data: int, late: bool, tick: Any) -> None:
    """Keep a TPDO, as one number, if it is newer than what is there and its drive owes it."""
    if late and tick.age[leg] <= 1:
        return
    if not c.has[slot] or c.held[slot] != data:
        if c.owed[slot] <= 0:
            tick.doubled |= 1 << leg
            return
        c.owed[slot] -= 1
    c.held[slot], c.has[slot], c.late[slot] = data, 1, late


@helper
def _move(c: Any, leg: int, at: int) -> None:
    """Let a drive be at a step of its plan that it has not been asked yet."""
    c.at[leg], c.asked[leg], c.tries[leg] = at, NOT_ASKED, 0
    if at == c.steps[leg]:
        c.refused[leg] = 0


@helper
def _answered(c: Any, leg: int, data: Any, tick: Any) -> bool:
    """Take an SDO answer; tell whether it is one.

    After a refusal the plan begins again, but not before the patience is over: it would be refused at once.
    """
    specifier, key, value = int(data[0]), whole(data, 1, 3), whole(data, 4)
    aborts, wrote, reads = specifier == 0x80, specifier >> 5 == 3, specifier >> 5 == 2 and specifier & 2 != 0
    if not (aborts or wrote or reads):
        return False
    if reads and specifier & 1:
        value &= (1 << 8 * (4 - (specifier >> 2 & 3))) - 1
    unknown = tick.drive_state[leg] == DriveState.FAULT and tick.drive_fault[leg] == DriveFault.NONE
    if key == _WHY and reads and unknown:
        tick.drive_fault[leg] = value
    at = c.at[leg]
    if at == c.steps[leg] or c.asked[leg] == NOT_ASKED:
        return True
    request, mask = c.requests[leg, at], c.masks[leg, at]
    if request >> 16 == 0 or request >> 8 & 0xFFFFFF != key:
        return True
    writes = request & 0xFF != o.UPLOAD
    lacks = aborts and mask & OPTIONAL and value in (o.NO_OBJECT, o.NO_SUB_INDEX)
    differs = reads and not writes and (value ^ c.values[leg, at]) & mask & _ALL_BITS != 0
    if differs or (aborts and not lacks):
        c.refused[leg], c.read[leg] = at + 1, value
        c.abort[leg] = (value or o.BAD_COMMAND) if aborts else 0
        _move(c, leg, 0)
        c.asked[leg] = tick.tick
    elif lacks or writes == wrote:
        _move(c, leg, at + 1)
    return True


@helper
def _beat(c: Any, leg: int, state: int, tick: Any) -> bool:
    """Take a heartbeat; tell whether it can be believed. A drive that boots or halts is set up again."""
    if state not in (o.BOOTS, o.STOPPED, o.OPERATES, o.PREPARES):
        return False
    if state == o.BOOTS or (state != o.OPERATES and c.at[leg] == c.steps[leg]):
        tick.drive_state[leg], c.has[leg] = DriveState.BOOT.value, 0
        if state == o.BOOTS:
            tick.drive_fault[leg] = DriveFault.NONE.value
        c.states[leg] = s.UNHEARD
        _move(c, leg, 0)
    return True


@helper
def _hear(c: Any, base: int, leg: int, frame: Any, since_ns: int, tick: Any) -> bool:
    """Take a frame that has the number of a drive; tell whether it can be believed."""
    data, size = frame.data, int(frame.length)
    late = frame.t_ns < since_ns + tick.latch_ns[leg]
    if base == _TPDO1:
        if size != _PLACE_BYTES or _STATE_OF[data[0] & 0x7F] == s.UNHEARD:
            return False
        _take(c, leg, leg, whole(data, 0, _PLACE_BYTES), late, tick)
    elif base == _TPDO2 and c.velocity:
        if size != _SPEED_BYTES:
            return False
        _take(c, LEGS + leg, leg, whole(data, 0, _SPEED_BYTES), late, tick)
    elif base == o.HEARTBEAT_ID:
        return size == 1 and _beat(c, leg, int(data[0]), tick)
    elif base == o.EMCY_ID:
        if size != _EMERGENCY_BYTES:
            return False
        tick.drive_fault[leg] = whole(data, 0, 2)
    elif base == o.SDO_REPLY_ID:
        return size == _SDO_BYTES and _answered(c, leg, data, tick)
    elif base == _RPDO:
        tick.foreign |= Foreign.COMMAND.value
    elif base == o.SDO_REQUEST_ID:
        tick.foreign |= Foreign.CONFIG.value
    return True


@helper
def _foreign(c: Any, identifier: int) -> int:
    """Return which frame of a controller has an identifier without the number of a drive."""
    if identifier == o.SYNC_ID:
        return Foreign.SYNC.value
    if identifier == o.NMT_ID:
        return Foreign.CONFIG.value
    return Foreign.COMMAND.value if identifier == o.HEARTBEAT_ID + c.controller else 0


@helper
def _begin(c: Any, last: Any, tick: Any) -> None:
    """Begin with what each drive owes, that for this tick's SYNC included."""
    begin_measurement(last, tick)
    for leg in range(LEGS):
        if last.age[leg]:
            c.missed[leg] = last.tick
        lately = tick.tick - c.missed[leg] <= STRAYING
        for slot in (leg, LEGS + leg):
            c.owed[slot] = 1 + (c.owed[slot] if lately else 0)
            c.has[slot] = 0


@helper
def _measure(c: Any, leg: int, last: Any, tick: Any) -> None:
    held, late = c.held[leg], c.late[leg] != 0
    state = _STATE_OF[held & 0x7F]
    if state == s.QUICK_STOP or (c.states[leg] == s.ENABLED and state == s.DISABLED):
        c.stopped |= 1 << leg
    c.states[leg] = state
    tick.drive_state[leg] = _DRIVE_STATE[state]
    tick.drive_force[leg] = signed(held >> 48 & 0xFFFF, 16) * c.N_per_permille[leg]
    has_speed = c.has[LEGS + leg] != 0
    if c.velocity and (not has_speed or (c.late[LEGS + leg] and not late)):
        return
    here = c.offset[leg] + c.m_per_count[leg] * signed(held >> 16 & _ALL_BITS, 32)
    if has_speed:
        tick.rate[leg] = c.m_per_count[leg] * signed(c.held[LEGS + leg], 32)
    else:
        of = last if late else tick
        latched_ns = of.t_ns + of.lateness_ns + of.latch_ns[leg]
        tick.rate[leg] = difference(c, leg, here, latched_ns, tick.rate[leg])
    tick.length[leg], tick.age[leg] = here, late
    at = c.at[leg]
    if not late and c.asked[leg] >= 0 and at < c.steps[leg] and c.requests[leg, at] >> 16 == 0:
        _move(c, leg, at + 1)


@helper
def _set_up(c: Any) -> int:
    legs = 0
    for leg in range(LEGS):
        legs |= int(c.at[leg] == c.steps[leg]) << leg
    return legs


@pointed(_DRIVES, INTEGER, INTEGER, INTEGER, _TICK, _TICK)
def decode(c: Any, frames: int, count: int, since_ns: int, last: Any, tick: Any) -> int:
    """Fill the measurement of a tick from that of the last one and the frames since.

    frames: address of `count` elements of FRAME; since_ns: when the loop woke up. A TPDO that came after this
    tick's SYNC had ended answers it; an earlier one answers the last one, and counts with age 1 if nothing
    newer is held. Refused, and counted in `rejected`: a wrong length, an unknown statusword or NMT state, an
    SDO frame that is not an expedited answer. A second TPDO of a tick with other data makes the node
    `doubled`, and the first one counts; unless the drive owes one to an earlier SYNC since it was missed
    within the last STRAYING ticks: then the last one counts. A leg is as old as the older one of its two
    TPDOs. Boot-up, and a drive that has left Operational, begin its set-up again. Returns 1 where other
    drives are set up than before, else 0.
    """
    _begin(c, last, tick)
    set_up = _set_up(c)
    received = frames_at(frames, count)
    for n in range(count):
        frame = received[n]
        identifier, bus = int(frame.id), int(frame.bus)
        base, leg = identifier & ~_NODE, place_of(identifier & _NODE, c.nodes)
        away = leg >= 0 and base in FROM_DRIVES and bus != c.bus_of[leg]
        if c.buses > 1 and (away or bus >= c.buses):
            tick.rejected += 1
        elif frame.flags & STRANGE or bus >= c.buses:
            continue
        elif leg < 0:
            tick.foreign |= _foreign(c, identifier)
        elif not _hear(c, base, leg, frame, since_ns, tick):
            tick.rejected += 1
    for leg in range(LEGS):
        if c.has[leg]:
            _measure(c, leg, last, tick)
    for leg in range(LEGS):
        if c.stopped >> leg & 1:
            if c.states[leg] in (s.DISABLED, s.READY_TO_SWITCH_ON, s.QUICK_STOP):
                tick.drive_state[leg] = DriveState.FAULT.value
                if tick.drive_fault[leg] == DriveFault.NONE:
                    tick.drive_fault[leg] = DriveFault.ESTOP.value
        elif tick.drive_fault[leg] == DriveFault.ESTOP:
            tick.drive_fault[leg] = DriveFault.NONE.value
        if not c.lossless:
            force = tick.drive_force[leg]
            tick.drive_force[leg] = force / loss_of(
                force, tick.rate[leg], c.driving[leg], c.back_driving[leg], c.full_loss_m_s
            )
        for slot in (leg, LEGS + leg):
            c.owed[slot] = min(c.owed[slot], STRAYING)
    c.rate[:] = tick.rate
    tick.counted_age[:] = tick.age
    return int(_set_up(c) != set_up)


@helper
def _permille(c: Any, leg: int, force: float) -> float:
    """Return a force in whole thousandths of the rated torque."""
    if c.lossless:
        return float(np.rint(force * c.permille_per_N[leg]))
    loss = loss_of(force, c.rate[leg], c.driving[leg], c.back_driving[leg], c.full_loss_m_s)
    return float(np.rint(loss * force / c.N_per_Nm[leg] / c.permille_Nm))


@pointed(_DRIVES, INTEGER, INTEGER, INTEGER, INTEGER, INTEGER)
def command(c: Any, number: int, mode: int, stop: int, force_at: int, into: int) -> int:
    """Put six RPDO1, and our heartbeat where it is due, into elements of FRAME at an address.

    force_at: address of (6,) N. Returns how many they are, or FAILED: a force does not fit.
    """
    force = reals_at(force_at, LEGS)
    for leg in range(LEGS):
        if not (np.isfinite(force[leg]) and abs(_permille(c, leg, force[leg])) <= MOST_PERMILLE):
            return FAILED
    done = _set_up(c)
    if mode == DriveMode.RESET:
        c.stopped, c.resets = 0, _ALL & ~done
    if stop:
        c.stopped = _ALL
    late = c.resets & done
    c.resets &= ~late
    c.mode = mode
    sent = frames_at(into, LEGS + c.buses)
    for leg in range(LEGS):
        frame, state, halted = sent[leg], c.states[leg], c.stopped >> leg & 1 != 0
        word = s.controlword(mode, state, number & 1 == 0, halted)
        if late >> leg & 1 and state == s.IN_FAULT and mode == DriveMode.OFF:
            word = s.RESET_FAULT
        powers = mode in (DriveMode.READY, DriveMode.RUN) and not halted
        torque = int(_permille(c, leg, force[leg])) if powers else 0
        begin_sent(frame, _RPDO + c.nodes[leg], 4, 0, c.bus_of[leg])
        for k in range(2):
            frame.data[k], frame.data[2 + k] = word >> 8 * k & 0xFF, torque >> 8 * k & 0xFF
    if number % c.beat:
        return LEGS
    for bus in range(c.buses):
        begin_sent(sent[LEGS + bus], o.HEARTBEAT_ID + c.controller, 1, 0, bus)
        sent[LEGS + bus].data[0] = o.OPERATES
    return LEGS + int(c.buses)
