"""The controller's end of six CiA 402 drives in Numba kernels, which share one record."""

from __future__ import annotations

from typing import Any

import numpy as np

from drivers.cia402 import objects as o
from drivers.cia402 import states as s
from drivers.compiled.compiler import INTEGER, helper, record
from drivers.compiled.pointed import FAILED, pointed, reals_at
from drivers.frame_pointers import (
    begin_measurement,
    begin_sent,
    frames_at,
    now_owed,
    place_of,
    signed,
    still_owed,
    whole,
)
from drivers.protocol import STRANGE
from drivers.signals import LEGS, DriveFault, DriveMode, DriveState, Foreign
from drivers.tick_columns import TICK, part
from drivers.transmission import FIELDS, loss_of

OLDEST = 50
"""Ticks after which a difference of lengths no longer gives a rate."""
SHORTEST = 0.5
"""Periods; a stall leaves shorter steps, over which the resolution of the encoder makes the rate too rough.
"""
MOST_PERMILLE = 32_767
MOST_STEPS = 96
"""Most steps of a plan."""
OPTIONAL = 1 << 32
"""Bit of a mask: a drive may lack the object."""
NOT_ASKED = -1
DRIVES = np.dtype(
    [
        ("nodes", "<i8", (LEGS,)),
        ("controller", "<i8"),  # its node number
        ("velocity", "<i8"),  # 1: TPDO2 carries the velocity
        ("buses", "<i8"),  # number of buses; frames of others are ignored
        ("bus_of", "<i8", (LEGS,)),
        ("beat", "<i8"),  # ticks from one heartbeat of ours to the next
        ("lossless", "<i8"),
        *((name, "<f8") for name in ("period_s", "permille_Nm")),
        *((name, "<f8", (LEGS,)) for name in ("m_per_count", "N_per_permille", "permille_per_N")),
        *FIELDS,
        # the start-up dialogue
        ("patience", "<i8"),  # ticks after which a request is repeated
        ("steps", "<i8", (LEGS,)),  # number of steps of each plan
        ("requests", "<i8", (LEGS, MOST_STEPS)),  # data of an SDO request; of NMT the command and the node
        ("values", "<i8", (LEGS, MOST_STEPS)),  # written or expected
        ("masks", "<i8", (LEGS, MOST_STEPS)),  # bits that are compared, and OPTIONAL
        ("at", "<i8", (LEGS,)),  # present step of a drive's plan
        ("asked", "<i8", (LEGS,)),  # tick of the unanswered request
        ("tries", "<i8", (LEGS,)),  # number of times that it was sent
        ("refused", "<i8", (LEGS,)),  # step, from 1 on, that was refused or has another value; 0: none
        ("abort", "<i8", (LEGS,)),  # its abort code; 0: it has another value
        ("read", "<i8", (LEGS,)),  # that value
        # state from earlier ticks
        ("states", "<i8", (LEGS,)),
        ("mode", "<i8"),  # of the last command
        ("stopped", "<i8"),  # bit i: drive i has had a quick stop, and no RESET since
        ("resets", "<i8"),  # bit i: drive i has missed a RESET, and gets one when it is set up
        ("rate", "<f8", (LEGS,)),
        ("owed", "<i8", (2 * LEGS,)),  # TPDO1, then TPDO2 of each drive: missing answers to earlier SYNCs
        # the step from one length of a leg to the next
        ("mean", "<f8", (LEGS,)),  # rate, m/s
        ("T", "<f8", (LEGS,)),  # s, between the two lengths; 0: there is only one
        ("latched_ns", "<i8", (LEGS,)),  # ns, time at which the last length was latched
        ("length", "<f8", (LEGS,)),  # m, of the last one
        ("has_length", "<i8", (LEGS,)),
        # scratch: TPDO1, then TPDO2 of a tick, their bytes as one number
        ("held", "<i8", (2 * LEGS,)),
        ("has", "<i8", (2 * LEGS,)),
        ("late", "<i8", (2 * LEGS,)),
    ]
)
"""Record of the controller's end of six drives."""
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
    """Leg rate, m/s, at the end of a step, from the last two mean rates; stores them for the next step.

    dq = d1 + (d1 - d0) T1 / (T1 + T0), the slope at the end of the parabola through the last three lengths:
    the mean rate d1 of the step alone is that of T1 / 2 ago. T is the time from SYNC to SYNC as the bus
    carried them: at 400 Hz a SYNC that is 25 us late moves a leg by 1 % of its step. A step shorter than
    SHORTEST periods leaves the last rate, m/s, unchanged and becomes part of the next step; after OLDEST
    periods the rate starts at 0. length: m; latched_ns: time at which the drive sampled it; rate: m/s, last.
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
    """Store a TPDO's data, one integer, if it is newer than the stored one and its drive owes an answer."""
    if c.held[slot] != data or not (c.has[slot] or late):  # else a copy
        if c.owed[slot] <= 0:
            tick.doubled |= 1 << leg
            return
        c.owed[slot] -= 1
    if late and tick.age[leg] <= 1:
        return
    c.held[slot], c.has[slot], c.late[slot] = data, 1, late


@helper
def _move(c: Any, leg: int, at: int) -> None:
    c.at[leg], c.asked[leg], c.tries[leg] = at, NOT_ASKED, 0
    if at == c.steps[leg]:
        c.refused[leg] = 0


@helper
def _answered(c: Any, leg: int, data: Any, tick: Any) -> bool:
    """Process a drive's SDO frame; False if it is not an expedited answer.

    After a refusal the dialogue restarts, but only after the waiting time: at once it would be refused again.
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
    """Process a heartbeat; False if invalid. A drive that boots, or leaves Operational, is set up again."""
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
    data, size = frame.data, int(frame.length)
    late = frame.t_ns < since_ns + tick.latch_ns[leg]
    if base == _TPDO1:
        if size != 8 or _STATE_OF[data[0] & 0x7F] == s.UNHEARD:
            return False
        _take(c, leg, leg, whole(data, 0, 8), late, tick)
    elif base == _TPDO2 and c.velocity:
        if size != 4:
            return False
        _take(c, LEGS + leg, leg, whole(data, 0, 4), late, tick)
    elif base == o.HEARTBEAT_ID:
        return size == 1 and _beat(c, leg, int(data[0]), tick)
    elif base == o.EMCY_ID:
        if size != 8:
            return False
        tick.drive_fault[leg] = whole(data, 0, 2)
    elif base == o.SDO_REPLY_ID:
        return size == 8 and _answered(c, leg, data, tick)
    elif base == _RPDO:
        tick.foreign |= Foreign.COMMAND.value
    elif base == o.SDO_REQUEST_ID:
        tick.foreign |= Foreign.CONFIG.value
    return True


@helper
def _foreign(c: Any, identifier: int) -> int:
    """Kind (Foreign) of another controller's frame to all nodes: SYNC, NMT, heartbeat; else 0."""
    if identifier == o.SYNC_ID:
        return Foreign.SYNC.value
    if identifier == o.NMT_ID:
        return Foreign.CONFIG.value
    return Foreign.COMMAND.value if identifier == o.HEARTBEAT_ID + c.controller else 0


@helper
def _begin(c: Any, last: Any, tick: Any) -> None:
    """Start a tick: each drive owes one answer to its SYNC, and perhaps answers to earlier ones."""
    begin_measurement(last, tick)
    for leg in range(LEGS):
        for slot in (leg, LEGS + leg):
            c.owed[slot] = now_owed(c.owed[slot], c.at[leg] == c.steps[leg])
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
    """Fill the measurement of a tick from that of the last tick and the frames received since.

    frames: address of `count` FRAME records; since_ns: wake-up time of the loop. A TPDO after the end of
    this tick's SYNC answers it. An earlier one answers the last SYNC, and counts with age 1 if nothing newer
    is held. Refused, and counted in `rejected`: a wrong length, an unknown statusword or NMT state, an SDO
    frame that is not an expedited answer. A TPDO with other data that the drive does not owe, see `now_owed`,
    marks the node as `doubled`; of two in a tick the last one that it owes counts. A leg is as old as the
    older of its two TPDOs.
    Boot-up, and leaving Operational, restart a drive's set-up. Returns 1 if the set of configured drives has
    changed, else 0.
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
        for slot in (leg, LEGS + leg):
            c.owed[slot] = still_owed(c.owed[slot], set_up >> leg & 1 != 0)
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
    c.rate[:] = tick.rate
    tick.counted_age[:] = tick.age
    return int(_set_up(c) != set_up)


@helper
def _permille(c: Any, leg: int, force: float) -> float:
    """Motor torque that gives a leg force (N, push positive), rounded to permille of the rated torque."""
    if c.lossless:
        return float(np.rint(force * c.permille_per_N[leg]))
    loss = loss_of(force, c.rate[leg], c.driving[leg], c.back_driving[leg], c.full_loss_m_s)
    return float(np.rint(loss * force / c.N_per_Nm[leg] / c.permille_Nm))


@pointed(_DRIVES, INTEGER, INTEGER, INTEGER, INTEGER, INTEGER)
def command(c: Any, number: int, mode: int, stop: int, force_at: int, into: int) -> int:
    """Write six RPDO1, and the controller's heartbeat if due, to FRAME records at the address `into`.

    number: of the tick; mode: a DriveMode; stop: 1 for an emergency stop; force_at: address of (6,) N, push
    positive. Returns the number of frames, or FAILED if a force does not fit.
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
    count = LEGS
    for bus in range(c.buses):
        if place_of(bus, c.bus_of) >= 0:
            begin_sent(sent[count], o.HEARTBEAT_ID + c.controller, 1, 0, bus)
            sent[count].data[0] = o.OPERATES
            count += 1
    return count
