"""The controller's end of six CiA 402 drives, compiled: one record, which has the dialogue.

What the start-up dialogue decides is left to Python: a function by address, called where an SDO answer comes
or a drive answers that is not set up.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from drivers.cia402 import objects as o
from drivers.cia402.states import DRIVE_STATE, RESET_FAULT, STATE_OF, UNHEARD, State, controlword
from drivers.compiled.compiler import INTEGER, helper, record
from drivers.compiled.pointed import FAILED, address_of, call, integers_at, pointed, reals_at
from drivers.frame_array import FRAME, SENT
from drivers.frame_pointers import begin_measurement, frames_at, place_of, signed, whole
from drivers.protocol import ERROR, EXTENDED, FD, REMOTE
from drivers.signals import LEGS, DriveFault, DriveMode, DriveState, Foreign
from drivers.tick_columns import TICK, part
from drivers.transmission import loss_of

OLDEST = 50
"""Ticks after which a difference of lengths says nothing of the rate."""
STRAYING = 8
"""Ticks after a drive was missed within which what it still owes may come: a stall shifts answers."""
SHORTEST = 0.5
"""Periods; a stall leaves shorter steps, over which the steps of the encoder make too rough a rate."""
MOST_PERMILLE = 32_767
NOT_ASKED = -1
STRANGE = EXTENDED | FD | REMOTE | ERROR
"""Flags of frames that cannot be ours."""
DRIVES = np.dtype(
    [
        ("news", "<i8"),  # address of news(leg, frame or 0, tick): the start-up dialogue
        ("nodes", "<i8", (LEGS,)),
        ("controller", "<i8"),  # its node
        ("velocity", "<i8"),  # 1: it comes in TPDO2
        ("buses", "<i8"),  # how many; 0: one, and frames of others are not ours
        ("bus_of", "<i8", (LEGS,)),
        ("period_s", "<f8"),
        # transmission
        ("lossless", "<i8"),
        ("offset", "<f8", (LEGS,)),
        ("m_per_count", "<f8", (LEGS,)),
        ("N_per_permille", "<f8", (LEGS,)),
        ("permille_per_N", "<f8", (LEGS,)),
        ("permille_Nm", "<f8"),
        ("N_per_Nm", "<f8", (LEGS,)),
        ("driving", "<f8", (LEGS,)),
        ("back_driving", "<f8", (LEGS,)),
        ("full_loss_m_s", "<f8"),
        # our heartbeat
        ("beat", "<i8"),  # ticks from one to the next
        ("beats", "<i8"),  # address of its frames
        ("beat_frames", "<i8"),  # how many
        # the dialogue, see `drivers.cia402.set_up.Cia402Dialogue`
        ("steps", "<i8", (LEGS,)),  # of each plan
        ("at", "<i8", (LEGS,)),
        ("asked", "<i8", (LEGS,)),
        ("tries", "<i8", (LEGS,)),
        ("states", "<i8", (LEGS,)),
        ("mode", "<i8"),
        ("stopped", "<i8"),
        ("resets", "<i8"),
        ("rate", "<f8", (LEGS,)),
        ("owed", "<i8", (2 * LEGS,)),
        ("missed", "<i8", (LEGS,)),
        # slopes
        ("mean", "<f8", (LEGS,)),
        ("T", "<f8", (LEGS,)),
        ("latched_ns", "<i8", (LEGS,)),
        ("length", "<f8", (LEGS,)),
        ("has_length", "<i8", (LEGS,)),
        # scratch: the TPDOs of a tick, those of kind 1 in the first six places
        ("held", "<i8", (2 * LEGS, 3)),
        ("has", "<i8", (2 * LEGS,)),
        ("late", "<i8", (2 * LEGS,)),
    ]
)
"""The controller's end of six drives."""
_PLACE, _SPEED = 0, 1
"""Kinds of TPDOs."""
_PLACE_BYTES, _SPEED_BYTES, _EMERGENCY_BYTES = 8, 4, 8
_DRIVES = record(DRIVES)
_TICK = record(TICK, "tick", "t_ns", "lateness_ns", "latch_ns", *part("measurement"))
_FRAME_BYTES = FRAME.itemsize
_STATE_OF = np.array(STATE_OF)
_DRIVE_STATE = np.array(DRIVE_STATE, np.int64)
_NODE = 0x7F
_BOOT, _FAULT = int(DriveState.BOOT), int(DriveState.FAULT)
_NONE, _ESTOP = int(DriveFault.NONE), int(DriveFault.ESTOP)
_OFF, _READY, _RUN, _RESET = map(int, DriveMode)
_FOREIGN_SYNC, _FOREIGN_COMMAND = int(Foreign.SYNC), int(Foreign.COMMAND)
_FOREIGN_CONFIG = int(Foreign.CONFIG)
_DISABLED, _READY_TO_SWITCH_ON = int(State.DISABLED), int(State.READY_TO_SWITCH_ON)
_ENABLED, _QUICK_STOP, _IN_FAULT = int(State.ENABLED), int(State.QUICK_STOP), int(State.FAULT)
_ALL = (1 << LEGS) - 1
_FROM_DRIVES = o.EMCY_ID, *o.TPDO_ID, o.SDO_REPLY_ID, o.HEARTBEAT_ID
_TPDO1, _TPDO2, _RPDO = o.TPDO_ID[0], o.TPDO_ID[1], o.RPDO_ID[0]


@helper
def difference(
    length: float,
    latched_ns: int,
    before: tuple[float, float, int, float],
    has_length: bool,
    rate: float,
    period_s: float,
) -> tuple[float, tuple[float, float, int, float]]:
    """Return the rate at the end of a step from the last two mean rates, and what the next one needs.

    dq = d1 + (d1 - d0) T1 / (T1 + T0), the slope at the end of the parabola through the last three lengths:
    the mean rate d1 of the step alone is that of T1 / 2 ago. T from SYNC to SYNC as the bus carried them: at
    400 Hz one that is 25 us late moves a leg by 1 % of its step. A step shorter than SHORTEST periods leaves
    the rate as it was read last, m/s, and is part of the next one; after OLDEST periods the rate begins at 0.
    before: `drivers.cia402.set_up.Slope`, whose length counts where there is one.
    """
    d0, T0, was_ns, was = before
    T1 = 1e-9 * (latched_ns - was_ns)
    if not has_length or OLDEST * period_s < T1:
        return 0.0, (0.0, 0.0, latched_ns, length)
    if SHORTEST * period_s > T1:
        return rate, before
    d1 = (length - was) / T1
    return d1 + ((d1 - d0) * T1 / (T1 + T0) if T0 != 0.0 else 0.0), (d1, T1, latched_ns, length)


@helper
def _take(c: Any, kind: int, leg: int, data: Any, late: bool, tick: Any) -> None:
    """Keep a TPDO, if it is newer than what is there and its drive owes it."""
    if late and tick.age[leg] <= 1:
        return
    slot = kind * LEGS + leg
    held = c.held[slot]
    word: Any = np.int64(0)
    torque: Any = np.int64(0)
    if kind == _PLACE:
        word, torque = whole(data, 0, 2), signed(whole(data, 6, 2), 16)
    number = signed(whole(data, 2 if kind == _PLACE else 0), 32)
    if not c.has[slot] or held[0] != word or held[1] != number or held[2] != torque:
        if c.owed[slot] <= 0:
            tick.doubled |= 1 << leg
            return
        c.owed[slot] -= 1
    held[0], held[1], held[2] = word, number, torque
    c.has[slot], c.late[slot] = 1, late


@helper
def _beat(c: Any, leg: int, state: int, tick: Any) -> bool:
    """Take a heartbeat; tell whether it can be believed. A drive that boots or halts is set up again."""
    if state not in (o.BOOTS, o.STOPPED, o.OPERATES, o.PREPARES):
        return False
    if state == o.BOOTS or (state != o.OPERATES and c.at[leg] == c.steps[leg]):
        tick.drive_state[leg], c.has[leg] = _BOOT, 0
        if state == o.BOOTS:
            tick.drive_fault[leg] = _NONE
        c.states[leg], c.at[leg], c.asked[leg], c.tries[leg] = UNHEARD, 0, NOT_ASKED, 0
    return True


@helper
def _hear(c: Any, base: int, leg: int, at: int, since_ns: int, tick: Any) -> bool:
    """Take a frame, at an address, that has the number of a drive; tell whether it can be believed."""
    frame = frames_at(at, 1)[0]
    data, size = frame.data, int(frame.length)
    late = frame.t_ns < since_ns + tick.latch_ns[leg]
    if base == _TPDO1:
        if size != _PLACE_BYTES or _STATE_OF[data[0] & 0x7F] == UNHEARD:
            return False
        _take(c, _PLACE, leg, data, late, tick)
    elif base == _TPDO2 and c.velocity:
        if size != _SPEED_BYTES:
            return False
        _take(c, _SPEED, leg, data, late, tick)
    elif base == o.HEARTBEAT_ID:
        return size == 1 and _beat(c, leg, int(data[0]), tick)
    elif base == o.EMCY_ID:
        if size != _EMERGENCY_BYTES:
            return False
        tick.drive_fault[leg] = whole(data, 0, 2)
    elif base == o.SDO_REPLY_ID:
        return bool(call(c.news, (leg, at, address_of(tick))))
    elif base == _RPDO:
        tick.foreign |= _FOREIGN_COMMAND
    elif base == o.SDO_REQUEST_ID:
        tick.foreign |= _FOREIGN_CONFIG
    return True


@helper
def _foreign(c: Any, identifier: int) -> int:
    """Return which frame of a controller has an identifier without the number of a drive."""
    if identifier == o.SYNC_ID:
        return _FOREIGN_SYNC
    if identifier == o.NMT_ID:
        return _FOREIGN_CONFIG
    return _FOREIGN_COMMAND if identifier == o.HEARTBEAT_ID + c.controller else 0


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
    """Put what a drive has sent into the tick."""
    held, late = c.held[leg], c.late[leg] != 0
    state = _STATE_OF[held[0] & 0x7F]
    if state == _QUICK_STOP or (c.states[leg] == _ENABLED and state == _DISABLED):
        c.stopped |= 1 << leg
    c.states[leg] = state
    tick.drive_state[leg] = _DRIVE_STATE[state]
    tick.drive_force[leg] = held[2] * c.N_per_permille[leg]
    has_speed = c.has[LEGS + leg] != 0
    if c.velocity and (not has_speed or (c.late[LEGS + leg] and not late)):
        return
    here = c.offset[leg] + c.m_per_count[leg] * held[1]
    if has_speed:
        tick.rate[leg] = c.m_per_count[leg] * c.held[LEGS + leg, 1]
    else:
        of = last if late else tick
        latched_ns = of.t_ns + of.lateness_ns + of.latch_ns[leg]
        before = c.mean[leg], c.T[leg], c.latched_ns[leg], c.length[leg]
        tick.rate[leg], then = difference(
            here, latched_ns, before, c.has_length[leg] != 0, tick.rate[leg], c.period_s
        )
        c.mean[leg], c.T[leg], c.latched_ns[leg], c.length[leg] = then
        c.has_length[leg] = 1
    tick.length[leg], tick.age[leg] = here, late
    if not late and c.asked[leg] >= 0 and c.at[leg] < c.steps[leg]:
        call(c.news, (leg, 0, address_of(tick)))


@helper
def _set_up(c: Any) -> int:
    """Return bits of the drives that have been set up."""
    legs = 0
    for leg in range(LEGS):
        legs |= int(c.at[leg] == c.steps[leg]) << leg
    return legs


@pointed(_DRIVES, INTEGER, INTEGER, INTEGER, _TICK, _TICK)
def decode(c: Any, frames: int, count: int, since_ns: int, last: Any, tick: Any) -> int:
    """Fill the measurement of a tick, see `Cia402Protocol.decode`.

    frames: address of `count` elements of FRAME. Returns 1 where other drives are set up than before, else 0.
    """
    _begin(c, last, tick)
    set_up = _set_up(c)
    received = frames_at(frames, count)
    for n in range(count):
        frame = received[n]
        identifier, bus = int(frame.id), int(frame.bus)
        base, leg = identifier & ~_NODE, place_of(identifier & _NODE, c.nodes)
        away = leg >= 0 and base in _FROM_DRIVES and bus != c.bus_of[leg]
        if c.buses and (away or bus >= c.buses):
            tick.rejected += 1
        elif frame.flags & STRANGE or bus >= max(c.buses, 1):
            continue
        elif leg < 0:
            tick.foreign |= _foreign(c, identifier)
        elif not _hear(c, base, leg, frames + n * _FRAME_BYTES, since_ns, tick):
            tick.rejected += 1
    for leg in range(LEGS):
        if c.has[leg]:
            _measure(c, leg, last, tick)
    for leg in range(LEGS):
        if c.stopped >> leg & 1:
            if c.states[leg] in (_DISABLED, _READY_TO_SWITCH_ON, _QUICK_STOP):
                tick.drive_state[leg] = _FAULT
                if tick.drive_fault[leg] == _NONE:
                    tick.drive_fault[leg] = _ESTOP
        elif tick.drive_fault[leg] == _ESTOP:
            tick.drive_fault[leg] = _NONE
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
    if mode == _RESET:
        c.stopped, c.resets = 0, _ALL & ~done
    if stop:
        c.stopped = _ALL
    late = c.resets & done
    c.resets &= ~late
    c.mode = mode
    sent = frames_at(into, LEGS)
    for leg in range(LEGS):
        frame, state, halted = sent[leg], c.states[leg], c.stopped >> leg & 1 != 0
        word = controlword(mode, state, number & 1 == 0, halted)
        if late >> leg & 1 and state == _IN_FAULT and mode == _OFF:
            word = RESET_FAULT
        torque = int(_permille(c, leg, force[leg])) if mode in (_READY, _RUN) and not halted else 0
        frame.t_ns, frame.kind, frame.flags, frame.length = 0, SENT, 0, 4
        frame.id, frame.bus = _RPDO + c.nodes[leg], c.bus_of[leg]
        frame.data[:] = 0
        for k in range(2):
            frame.data[k], frame.data[2 + k] = word >> 8 * k & 0xFF, torque >> 8 * k & 0xFF
    if number % c.beat:
        return LEGS
    words = c.beat_frames * (_FRAME_BYTES // 8)
    integers_at(into + LEGS * _FRAME_BYTES, words)[:] = integers_at(c.beats, words)
    return LEGS + int(c.beat_frames)
