"""The drives' end of CiA 402, compiled: SYNC, PDOs and heartbeats of six emulated drives.

NMT, SDO, EMCY, and what is rejected are left to `devices`.
"""

from typing import Any

import numpy as np

from drivers.cia402 import objects as o
from drivers.cia402.dictionary import ENTRIES, MAPPED, PDOS, TORQUE_MODES
from drivers.cia402.kernels import STRANGE
from drivers.cia402.states import STATUSWORDS, State, commanded
from drivers.compiled.compiler import INTEGER, helper, record
from drivers.compiled.pointed import FAILED, integers_at, pointed, record_at
from drivers.ends import ALIVE, MESSAGE, STOP, SYNC, UNWATCHED, frame_at, message_at, reading_at
from drivers.frame_array import FRAME
from drivers.frame_pointers import begin_sent, place_of, signed, whole
from drivers.signals import INVALID, LEGS, DriveFault, DriveMode, DriveState
from drivers.transmission import loss_of

MAPPABLE = (
    o.CONTROLWORD,
    o.TARGET_TORQUE,
    o.MODE,
    o.STATUSWORD,
    o.POSITION,
    o.VELOCITY,
    o.TORQUE,
    o.ERROR_CODE,
    o.MODE_SHOWN,
)
"""Objects that a PDO can carry."""
_WORD, _TARGET, _MODE, _STATUS, _POSITION, _VELOCITY, _TORQUE, _ERROR, _SHOWN = range(len(MAPPABLE))
_SIZES = tuple(ENTRIES[key].size for key in MAPPABLE)
REMEMBERED = ("nmt", "state", "word", "torque", "error", "commands", "started", "stops")
"""What a `Device` remembers besides its objects."""
ACTUAL = ("position", "velocity", "current")
DEVICE = np.dtype(
    [
        *((name, "<i8") for name in ("leg", "node", *REMEMBERED, *ACTUAL)),
        # objects
        *((name, "<i8") for name in ("mode", "shown", "most", "quick", "consumer", "producer")),
        ("scale", "<f8"),  # N at the leg of a permille
        # RPDOs and TPDOs: identifiers, 0: none; bytes; how many objects, and their places in MAPPABLE
        *((name, "<i8", (PDOS,)) for name in ("heard", "size", "entries", "sent", "sends")),
        ("takes", "<i8", (PDOS, MAPPED)),
        ("holds", "<i8", (PDOS, MAPPED)),
    ]
)
"""One drive, see `drivers.cia402.device.Device`."""
DEVICES = np.dtype(
    [
        ("devices", "<i8"),  # address of six elements of DEVICE
        ("stops", "<i8"),  # 1: it takes what stops a drive quickly, else that is left to its owner
        ("buses", "<i8"),  # how many; 0: one
        ("bus_of", "<i8", (LEGS,)),
        ("nodes", "<i8", (LEGS,)),
        ("velocity", "<i8"),  # 1: the controller waits for TPDO2
        ("codes", "<i8", (len(DriveFault),)),  # of an EMCY, by fault
        ("rated_mNm", "<f8"),
        *((name, "<f8", (LEGS,)) for name in ("offset", "m_per_turn", "counts", "N_per_Nm")),
        *((name, "<f8", (LEGS,)) for name in ("driving", "back_driving")),
        ("full_loss_m_s", "<f8"),
    ]
)
"""Six emulated drives."""
_DEVICE, _DEVICES = record(DEVICE), record(DEVICES)
_device_at: Any = record_at(_DEVICE)
_ROW, _FRAME, _MESSAGE = DEVICE.itemsize, FRAME.itemsize, MESSAGE.itemsize
_STATUSWORDS = np.array([STATUSWORDS[state] for state in State])
_BOOT, _FAULT = int(DriveState.BOOT), int(DriveState.FAULT)
_OFF, _READY, _RUN, _RESET = map(int, DriveMode)
_DISABLED, _ENABLED, _QUICK_STOP = int(State.DISABLED), int(State.ENABLED), int(State.QUICK_STOP)
_FAULT_REACTION, _IN_FAULT = int(State.FAULT_REACTION), int(State.FAULT)
_NODE = 0x7F
_LEAST_WORD, _MOST_WORD = -float(1 << 31), float((1 << 31) - 1)
_LEAST_SHORT, _MOST_SHORT = -float(1 << 15), float((1 << 15) - 1)
_TPDO1, _TPDO2 = o.TPDO_ID[0], o.TPDO_ID[1]
_RPDOS = o.RPDO_ID


@helper
def _device(c: Any, leg: int) -> Any:
    return _device_at(c.devices + leg * _ROW)


# commands


@helper
def _following(d: Any, word: int) -> int:
    """Return the state to which a controlword leads."""
    state = commanded(word, d.state, not d.word & 0x80)
    stops_at_once = state == _QUICK_STOP and d.state == _ENABLED and d.quick == 0
    return _DISABLED if stops_at_once else state


@helper
def _put(messages: int, count: int, leg: int, kind: int, mode: int, counter: int, force: float) -> int:
    """Put a message into elements of MESSAGE at an address; return how many there are."""
    message = message_at(messages + count * _MESSAGE)
    message.kind, message.mode, message.counter, message.count = kind, mode, counter, 1
    message.legs[0], message.force[0] = leg, force
    return count + 1


@helper
def _control(d: Any, word: int, torque: int, messages: int) -> int:
    state, before, n, count = _following(d, word), d.state, d.commands, 0
    if state == _ENABLED:
        most = d.most if d.mode else 0
        force = min(max(torque, -most), most) * d.scale
        if before != _ENABLED:
            count = _put(messages, count, d.leg, UNWATCHED, _READY, n + 1, force)
        count = _put(messages, count, d.leg, UNWATCHED, _RUN, n + 2, force)
    elif state == _QUICK_STOP:
        if before != _QUICK_STOP:
            count = _put(messages, count, d.leg, STOP, 0, 0, 0.0)
    elif before == _ENABLED:
        count = _put(messages, count, d.leg, UNWATCHED, _OFF, n + 1, 0.0)
    elif before in (_IN_FAULT, _DISABLED) and state != before:
        count = _put(messages, count, d.leg, UNWATCHED, _RESET, n + 1, 0.0)
    d.stops = d.stops != 0 and state == _QUICK_STOP
    d.word, d.torque, d.state, d.commands = word, torque, state, n + 2
    return count


@pointed(_DEVICE, INTEGER, INTEGER, INTEGER)
def control(d: Any, word: int, torque: int, messages: int) -> int:
    """Let a controlword and a target torque act; without a mode of operation no torque follows."""
    return _control(d, word, torque, messages)


@helper
def _carried(d: Any, k: int, data: Any) -> tuple[int, int, int]:
    """Return controlword, target torque and mode of operation after an RPDO."""
    at, word, torque, mode = 0, d.word, d.torque, d.mode
    for j in range(d.entries[k]):
        what = d.takes[k, j]
        value = whole(data, at, _SIZES[what])
        at += _SIZES[what]
        if what == _WORD:
            word = value
        elif what == _TARGET:
            torque = signed(value, 16)
        elif value in TORQUE_MODES:
            mode = value
    return word, torque, mode


@helper
def _listens(c: Any, leg: int, k: int, frame: Any) -> bool:
    heard = _device(c, leg).heard[k]
    return bool(heard != 0 and heard == frame.id and c.bus_of[leg] == frame.bus)


@helper
def _listeners(c: Any, frame: Any) -> int:
    """Return bits of the legs whose RPDO a frame is; FAILED for one that is cut, or stops a drive quickly."""
    found = 0
    for leg in range(LEGS):
        for k in range(PDOS):
            if not _listens(c, leg, k, frame):
                continue
            d, again = _device(c, leg), found >> leg & 1
            found |= 1 << leg
            if d.nmt != o.OPERATES:
                continue
            if frame.length < d.size[k]:
                return FAILED
            stops = _following(d, _carried(d, k, frame.data)[0]) == _QUICK_STOP != d.state
            if (stops or again) and not c.stops:
                return FAILED
    return found


@helper
def _obey(c: Any, frame: Any, messages: int) -> int:
    """Take an RPDO at the drives that listen to it."""
    count = 0
    for leg in range(LEGS):
        d = _device(c, leg)
        for k in range(PDOS):
            if d.nmt == o.OPERATES and _listens(c, leg, k, frame):
                word, torque, mode = _carried(d, k, frame.data)
                if mode != d.mode:
                    d.mode = d.shown = mode
                count += _control(d, word, torque, messages + count * _MESSAGE)
    return count


@helper
def _to_all(c: Any, kind: int, bus: int, node: int, messages: int) -> int:
    """Put a SYNC, or a heartbeat of a node for the drives that watch it, into a message."""
    message, count = message_at(messages), 0
    for leg in range(LEGS):
        d = _device(c, leg)
        if c.bus_of[leg] != bus:
            continue
        if kind == SYNC:
            hears = d.nmt == o.OPERATES and d.sends[0] > 0
            if d.state == _FAULT_REACTION:
                d.state = _IN_FAULT
        else:
            hears = d.nmt != o.BOOTS and d.consumer & 0xFFFF != 0 and d.consumer >> 16 & _NODE == node
        if hears:
            message.legs[count] = leg
            count += 1
    message.kind, message.counter, message.count = kind, 0, count
    return 1 if count or kind == SYNC else 0


@pointed(_DEVICES, INTEGER, INTEGER)
def parse(c: Any, frame_address: int, messages: int) -> int:
    """Decode a SYNC, a PDO or a heartbeat, see `Devices.parse`."""
    frame = frame_at(frame_address)
    if frame.flags & STRANGE or frame.bus >= max(c.buses, 1):
        return 0
    found = _listeners(c, frame)
    if found != 0:
        return FAILED if found < 0 else _obey(c, frame, messages)
    identifier = int(frame.id)
    node = identifier & _NODE
    if identifier == o.SYNC_ID:
        return _to_all(c, SYNC, frame.bus, 0, messages)
    if identifier == o.NMT_ID:
        return FAILED
    if identifier - node == o.HEARTBEAT_ID:
        return _to_all(c, ALIVE, frame.bus, node, messages) if frame.length == 1 else FAILED
    return FAILED if identifier - node == o.SDO_REQUEST_ID and place_of(node, c.nodes) >= 0 else 0


# answers


@helper
def _whole(number: float, least: float, most: float) -> int:
    """Return the nearest whole number, saturated."""
    return int(np.rint(min(max(number, least), most)))


@helper
def _measure(c: Any, leg: int, reading: Any) -> bool:
    """Take what a drive reads; tell whether these are numbers."""
    d, force, rate = _device(c, leg), reading.force[leg], reading.rate[leg]
    loss = loss_of(force, rate, c.driving[leg], c.back_driving[leg], c.full_loss_m_s)
    position = (reading.length[leg] - c.offset[leg]) / c.m_per_turn[leg] * c.counts[leg]
    velocity = rate / c.m_per_turn[leg] * c.counts[leg]
    torque = loss * force / c.N_per_Nm[leg] * 1e6 / c.rated_mNm
    if np.isnan(position) or np.isnan(velocity) or np.isnan(torque):
        return False
    d.position = _whole(position, _LEAST_WORD, _MOST_WORD)
    d.velocity = _whole(velocity, _LEAST_WORD, _MOST_WORD)
    d.current = _whole(torque, _LEAST_SHORT, _MOST_SHORT)
    return True


@helper
def _object(d: Any, what: int) -> int:
    """Return an object that a TPDO carries."""
    if what == _STATUS:
        return int(_STATUSWORDS[d.state])
    if what == _POSITION:
        return int(d.position)
    if what == _VELOCITY:
        return int(d.velocity)
    if what == _TORQUE:
        return int(d.current)
    return int(d.error if what == _ERROR else d.shown)


@helper
def _send(d: Any, bus: int, k: int, frame: Any) -> None:
    """Fill in a TPDO."""
    begin_sent(frame, d.sent[k], 0, 0, bus)
    at = 0
    for j in range(d.sends[k]):
        what = d.holds[k, j]
        value = _object(d, what)
        for n in range(_SIZES[what]):
            frame.data[at] = value >> 8 * n & 0xFF
            at += 1
    frame.length = at


@pointed(_DEVICES, INTEGER, INTEGER, INTEGER, INTEGER)
def answer(c: Any, sync_address: int, reading_address: int, into: int, senders: int) -> int:
    """Fill in the TPDOs of a SYNC and the leg of each; FAILED for a NaN, and where a drive has restarted."""
    sync, reading = message_at(sync_address), reading_at(reading_address)
    legs, asked, buses, count = integers_at(senders, LEGS * PDOS), 0, 0, 0
    for k in range(sync.count):
        asked |= 1 << sync.legs[k]
        buses |= 1 << c.bus_of[sync.legs[k]]
    if c.buses and not asked:
        return 0
    for leg in range(LEGS):
        if c.buses and not buses >> c.bus_of[leg] & 1:
            continue
        if reading.state[leg] & ~INVALID == _BOOT and _device(c, leg).started:
            return FAILED
        if not _measure(c, leg, reading):
            return FAILED
    for bus in range(max(c.buses, 1)):
        for leg in range(LEGS):
            d, state = _device(c, leg), reading.state[leg]
            if c.bus_of[leg] != bus or not asked >> leg & 1 or d.nmt != o.OPERATES:
                continue
            if state == _BOOT or state & INVALID:
                continue
            for k in range(PDOS):
                if d.sends[k]:
                    _send(d, bus, k, frame_at(into + count * _FRAME))
                    legs[count] = leg
                    count += 1
    return count


@pointed(_DEVICES, *[INTEGER] * 7)
def report(
    c: Any, leg: int, state: int, fault: int, _watchdog_ns: int, _reaction: int, _due: int, into: int
) -> int:
    """Fill in a heartbeat, and let a quick stop that has been reported end; FAILED for boot-up and EMCY."""
    d = _device(c, leg)
    in_fault = state == _FAULT
    trips, recovers = in_fault and c.codes[fault] and not d.error, d.error and not in_fault
    if d.nmt == o.BOOTS or (state == _BOOT and d.started) or trips or recovers:
        return FAILED
    if d.state == _QUICK_STOP:
        if d.stops:
            d.state = _DISABLED
        d.stops = 1
    if not d.producer:
        return 0
    frame = frame_at(into)
    begin_sent(frame, o.HEARTBEAT_ID + d.node, 1, 0, c.bus_of[leg])
    frame.data[0] = d.nmt
    return 1


# the controller's end, as far as it hears


@pointed(_DEVICES, INTEGER, INTEGER, INTEGER)
def fresh(c: Any, frame_address: int, _tick: int, since_ns: int) -> int:
    """Return the leg, from 1 on, plus LEGS for TPDO2, of a TPDO since this tick's SYNC on its bus; else 0."""
    frame = frame_at(frame_address)
    identifier = int(frame.id)
    leg = place_of(identifier & _NODE, c.nodes)
    if leg < 0 or frame.flags & STRANGE or frame.bus != c.bus_of[leg] or frame.t_ns < since_ns:
        return 0
    base = identifier & ~_NODE
    if base == _TPDO1:
        return leg + 1 if frame.length == 8 else 0
    return leg + LEGS + 1 if base == _TPDO2 and c.velocity and frame.length == 4 else 0


@pointed(_DEVICES, INTEGER)
def addressed(c: Any, frame_address: int) -> int:
    """Return which legs a frame is for, bit i: that of a PDO, SDO or NMT command to one node; else all."""
    frame = frame_at(frame_address)
    identifier = int(frame.id)
    base = identifier & ~_NODE
    node = identifier & _NODE if base in _RPDOS or base == o.SDO_REQUEST_ID else 0
    if identifier == o.NMT_ID:
        node = int(frame.data[1]) if frame.length > 1 else -1
    legs = 0
    for leg in range(LEGS):
        if (node == 0 or c.nodes[leg] == node) and (not c.buses or frame.bus == c.bus_of[leg]):
            legs |= 1 << leg
    return legs
