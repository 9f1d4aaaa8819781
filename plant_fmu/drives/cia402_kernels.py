"""The drives' end of CiA 402 in kernels: SYNC, PDOs, heartbeats and EMCY of six emulated drives.

`plant_fmu.drives.cia402` processes NMT, SDO and rejected frames.
"""

from typing import Any

import numpy as np

from drivers.cia402 import objects as o
from drivers.cia402 import states as s
from drivers.cia402.states import HEARTBEAT_LOST
from drivers.compiled.compiler import INTEGER, helper, record
from drivers.compiled.pointed import FAILED, integers_at, pointed, record_at
from drivers.frame_array import FRAME
from drivers.frame_pointers import begin_sent, frame_at, place_of, signed, whole
from drivers.protocol import STRANGE
from drivers.signals import INVALID, LEGS, DriveFault, DriveMode, DriveState
from drivers.transmission import FIELDS
from plant_fmu.drives import codec
from plant_fmu.drives.cia402_dictionary import ENTRIES, MAPPED, PDOS, PLACE, TORQUE_MODES

_WORD, _TARGET, _MODE, _SHOWN = (PLACE[key] for key in (o.CONTROLWORD, o.TARGET_TORQUE, o.MODE, o.MODE_SHOWN))
_POSITION, _VELOCITY, _TORQUE, _STATUS = (
    PLACE[key] for key in (o.POSITION, o.VELOCITY, o.TORQUE, o.STATUSWORD)
)
_ERROR, _REGISTER, _COMMUNICATION = (
    PLACE[key] for key in (o.ERROR_CODE, o.ERROR_REGISTER, o.COMMUNICATION_ERROR)
)
_CONSUMER, _PRODUCER, _MOST, _QUICK = (
    PLACE[key] for key in (o.CONSUMER_HEARTBEAT, o.PRODUCER_HEARTBEAT, o.MAX_TORQUE, o.QUICK_STOP)
)
_SIZES = np.array([entry.size for entry in ENTRIES.values()])
DEVICE = np.dtype(
    [
        ("nmt", "<i8"),
        ("state", "<i8"),
        ("commands", "<i8"),  # number so far
        ("started", "<i8"),  # 1: has been in Operational since power-up
        ("stops", "<i8"),  # 1: has reported its quick stop
        ("values", "<i8", (len(ENTRIES),)),  # object dictionary
        # computed from it, for RPDOs and synchronous TPDOs: identifiers, 0: none; bytes; indices of objects
        *((name, "<i8", (2, PDOS)) for name in ("pdos", "sizes", "counts")),
        ("places", "<i8", (2, PDOS, MAPPED)),
    ]
)
"""State of one emulated CiA 402 drive."""
DEVICES = np.dtype(
    [
        ("devices", "<i8"),  # address of six DEVICE records
        ("new", "<i8"),  # address of six elements as at power-up
        ("buses", "<i8"),  # number
        ("bus_of", "<i8", (LEGS,)),
        ("nodes", "<i8", (LEGS,)),
        ("codes", "<i8", (len(DriveFault),)),  # EMCY code per fault
        ("rated_mNm", "<f8"),
        *FIELDS,
        *((name, "<f8", (LEGS,)) for name in ("counts", "N_per_permille")),
    ]
)
"""State of six emulated CiA 402 drives."""
_DEVICES = record(DEVICES)
_device_at: Any = record_at(record(DEVICE))
_ROW, _FRAME, _MESSAGE = DEVICE.itemsize, FRAME.itemsize, codec.MESSAGE.itemsize
_STATUSWORDS = np.array([*s.STATUSWORDS.values()])
_BOOT, _FAULT = int(DriveState.BOOT), int(DriveState.FAULT)
_OFF, _READY, _RUN, _RESET = map(int, DriveMode)
_NODE = 0x7F
_LEAST_WORD, _MOST_WORD = -float(1 << 31), float((1 << 31) - 1)
_LEAST_SHORT, _MOST_SHORT = -float(1 << 15), float((1 << 15) - 1)


@helper
def _device(c: Any, leg: int) -> Any:
    return _device_at(c.devices + leg * _ROW)


# commands


@helper
def _following(d: Any, word: int) -> int:
    """CiA 402 state that a drive enters from its present one after a controlword."""
    state = s.commanded(word, d.state, not d.values[_WORD] & 0x80)
    stops_at_once = state == s.QUICK_STOP and d.state == s.ENABLED and d.values[_QUICK] == 0
    return s.DISABLED if stops_at_once else state


@helper
def _control(c: Any, leg: int, word: int, torque: int, messages: int) -> int:
    d = _device(c, leg)
    state, before, n, count = _following(d, word), d.state, d.commands, 0
    if state == s.ENABLED:
        most = d.values[_MOST] if d.values[_MODE] else 0
        force = min(max(torque, -most), most) * c.N_per_permille[leg]
        if before != s.ENABLED:
            count = codec.put_message(messages, count, leg, codec.UNWATCHED, _READY, n + 1, force)
        count = codec.put_message(messages, count, leg, codec.UNWATCHED, _RUN, n + 2, force)
    elif state == s.QUICK_STOP:
        if before != s.QUICK_STOP:
            count = codec.put_message(messages, count, leg, codec.STOP, 0, 0, 0.0)
    elif before == s.ENABLED:
        count = codec.put_message(messages, count, leg, codec.UNWATCHED, _OFF, n + 1, 0.0)
    elif before in (s.IN_FAULT, s.DISABLED) and state != before:
        count = codec.put_message(messages, count, leg, codec.UNWATCHED, _RESET, n + 1, 0.0)
    d.stops = d.stops != 0 and state == s.QUICK_STOP
    d.values[_WORD], d.values[_TARGET], d.state, d.commands = word, torque, state, n + 2
    return count


@pointed(_DEVICES, INTEGER, INTEGER, INTEGER)
def control(c: Any, leg: int, word: int, messages: int) -> int:
    """Execute a controlword with the stored target torque; without a mode of operation the torque is 0.

    Writes the commands to the drive (MESSAGEs) to the address `messages`; returns their number.
    """
    return _control(c, leg, word, _device(c, leg).values[_TARGET], messages)


@helper
def _carried(d: Any, k: int, data: Any) -> tuple[int, int, int]:
    at, word, torque, mode = 0, d.values[_WORD], d.values[_TARGET], d.values[_MODE]
    for j in range(d.counts[0, k]):
        what = d.places[0, k, j]
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
    heard = _device(c, leg).pdos[0, k]
    return bool(heard != 0 and heard == frame.id and c.bus_of[leg] == frame.bus)


@helper
def _listeners(c: Any, frame: Any) -> int:
    """Legs whose drives receive a frame as an RPDO, bit i: leg i; FAILED if it is too short."""
    found = 0
    for leg in range(LEGS):
        for k in range(PDOS):
            if not _listens(c, leg, k, frame):
                continue
            d = _device(c, leg)
            found |= 1 << leg
            if d.nmt == o.OPERATES and frame.length < d.sizes[0, k]:
                return FAILED
    return found


@helper
def _obey(c: Any, frame: Any, messages: int) -> int:
    count = 0
    for leg in range(LEGS):
        d = _device(c, leg)
        for k in range(PDOS):
            if d.nmt == o.OPERATES and _listens(c, leg, k, frame):
                word, torque, mode = _carried(d, k, frame.data)
                if mode != d.values[_MODE]:
                    d.values[_MODE] = d.values[_SHOWN] = mode
                count += _control(c, leg, word, torque, messages + count * _MESSAGE)
    return count


@helper
def _to_all(c: Any, kind: int, bus: int, node: int, messages: int) -> int:
    message, count = codec.message_at(messages), 0
    for leg in range(LEGS):
        d = _device(c, leg)
        if c.bus_of[leg] != bus:
            continue
        if kind == codec.SYNC:
            hears = d.nmt == o.OPERATES and d.counts[1, 0] > 0
            if d.state == s.FAULT_REACTION:
                d.state = s.IN_FAULT
        else:
            watched = d.values[_CONSUMER]
            hears = d.nmt != o.BOOTS and watched & 0xFFFF != 0 and watched >> 16 & _NODE == node
        if hears:
            message.legs[count] = leg
            count += 1
    message.kind, message.counter, message.count = kind, 0, count
    return 1 if count or kind == codec.SYNC else 0


@pointed(_DEVICES, INTEGER, INTEGER)
def parse(c: Any, frame_address: int, messages: int) -> int:
    """Decode SYNC, PDO or heartbeat to MESSAGEs; returns their number, FAILED to leave it to Python."""
    frame = frame_at(frame_address)
    if frame.flags & STRANGE or frame.bus >= c.buses:
        return 0
    found = _listeners(c, frame)
    if found != 0:
        return FAILED if found < 0 else _obey(c, frame, messages)
    identifier = int(frame.id)
    node = identifier & _NODE
    if identifier == o.SYNC_ID:
        return _to_all(c, codec.SYNC, frame.bus, 0, messages)
    if identifier == o.NMT_ID:
        return FAILED
    if identifier - node == o.HEARTBEAT_ID:
        return _to_all(c, codec.ALIVE, frame.bus, node, messages) if frame.length == 1 else FAILED
    return FAILED if identifier - node == o.SDO_REQUEST_ID and place_of(node, c.nodes) >= 0 else 0


# answers


@helper
def _restart(c: Any, leg: int) -> None:
    """Restore the power-up state of a drive, except its count of commands."""
    commands = _device(c, leg).commands + 1
    integers_at(c.devices + leg * _ROW, _ROW // 8)[:] = integers_at(c.new + leg * _ROW, _ROW // 8)
    _device(c, leg).commands = commands


@helper
def _whole(number: float, least: float, most: float) -> int:
    return int(np.rint(min(max(number, least), most)))


@helper
def _measure(c: Any, leg: int, reading: Any) -> bool:
    """Write position, velocity and torque of a reading to the drive's objects; False if one is NaN."""
    d, (turns, speed, torque) = _device(c, leg), codec.at_motor(c, leg, reading)
    position, velocity, torque = turns * c.counts[leg], speed * c.counts[leg], torque * 1e6 / c.rated_mNm
    if np.isnan(position) or np.isnan(velocity) or np.isnan(torque):
        return False
    d.values[_POSITION] = _whole(position, _LEAST_WORD, _MOST_WORD)
    d.values[_VELOCITY] = _whole(velocity, _LEAST_WORD, _MOST_WORD)
    d.values[_TORQUE] = _whole(torque, _LEAST_SHORT, _MOST_SHORT)
    return True


@helper
def _send(d: Any, bus: int, k: int, frame: Any) -> None:
    begin_sent(frame, d.pdos[1, k], 0, 0, bus)
    at = 0
    for j in range(d.counts[1, k]):
        what = d.places[1, k, j]
        value = _STATUSWORDS[d.state] if what == _STATUS else d.values[what]
        for n in range(_SIZES[what]):
            frame.data[at] = value >> 8 * n & 0xFF
            at += 1
    frame.length = at


@pointed(_DEVICES, INTEGER, INTEGER, INTEGER, INTEGER)
def answer(c: Any, sync_address: int, reading_address: int, into: int, senders: int) -> int:
    """Write the TPDOs that answer a SYNC to `into`, their legs to `senders`; returns how many, or FAILED."""
    sync, reading = codec.message_at(sync_address), codec.reading_at(reading_address)
    legs, asked, buses, count = integers_at(senders, LEGS * PDOS), 0, 0, 0
    for k in range(sync.count):
        asked |= 1 << sync.legs[k]
        buses |= 1 << c.bus_of[sync.legs[k]]
    if c.buses > 1 and not asked:
        return 0
    for leg in range(LEGS):
        if c.buses > 1 and not buses >> c.bus_of[leg] & 1:
            continue
        if reading.state[leg] & ~INVALID == _BOOT and _device(c, leg).started:
            _restart(c, leg)
        if not _measure(c, leg, reading):
            return FAILED
    for bus in range(c.buses):
        for leg in range(LEGS):
            d, state = _device(c, leg), reading.state[leg]
            if c.bus_of[leg] != bus or not asked >> leg & 1 or d.nmt != o.OPERATES:
                continue
            if state == _BOOT or state & INVALID:
                continue
            for k in range(PDOS):
                if d.counts[1, k]:
                    _send(d, bus, k, frame_at(into + count * _FRAME))
                    legs[count] = leg
                    count += 1
    return count


@pointed(_DEVICES, *[INTEGER] * 7)
def report(
    c: Any, leg: int, state: int, fault: int, _watchdog_ns: int, _reaction: int, _due: int, into: int
) -> int:
    """Write a drive's boot-up message, or else its EMCY and heartbeat, to address `into`; returns how many.

    A quick stop that was reported before ends in Switch On Disabled.
    """
    d, count = _device(c, leg), 0
    if state == _BOOT and d.started:
        _restart(c, leg)
    if d.nmt == o.BOOTS:
        d.nmt, d.state = o.PREPARES, s.DISABLED
        begin_sent(frame_at(into), o.HEARTBEAT_ID + c.nodes[leg], 1, 0, c.bus_of[leg])
        return 1
    code = c.codes[fault] if state == _FAULT else 0
    if (code and not d.values[_ERROR]) or (d.values[_ERROR] and state != _FAULT):
        if code:
            d.state = s.FAULT_REACTION
        if code == HEARTBEAT_LOST and d.values[_COMMUNICATION] == 0 and d.nmt == o.OPERATES:
            d.nmt = o.PREPARES
        register = (0x11 if code >> 8 == 0x81 else 0x01) if code else 0
        d.values[_ERROR], d.values[_REGISTER] = code, register
        emergency = frame_at(into)
        begin_sent(emergency, o.EMCY_ID + c.nodes[leg], 8, 0, c.bus_of[leg])
        emergency.data[0], emergency.data[1], emergency.data[2] = code & 0xFF, code >> 8, register
        count = 1
    if d.state == s.QUICK_STOP:
        if d.stops:
            d.state = s.DISABLED
        d.stops = 1
    if not d.values[_PRODUCER]:
        return count
    beat = frame_at(into + count * _FRAME)
    begin_sent(beat, o.HEARTBEAT_ID + c.nodes[leg], 1, 0, c.bus_of[leg])
    beat.data[0] = d.nmt
    return count + 1
