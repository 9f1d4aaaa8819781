"""The drives' end of protocol `legs`: fields of `drivers.legs.kernels`, checksums of `drivers.legs.crc`.

CONFIG and E-stop are processed in Python, the other frames in kernels.
"""

from typing import Any

import numpy as np

from drivers.compiled.compiler import INTEGER, helper
from drivers.compiled.pointed import FAILED, integers_at, pointed
from drivers.frame_array import FRAME
from drivers.frame_pointers import begin_sent, frame_at, place_of, whole
from drivers.legs import crc, kernels
from drivers.protocol import Frame
from drivers.signals import LEGS, DriveMode, Reaction
from plant_fmu.drives.codec import COMMAND, CONFIGURE, REJECTED, STOP, SYNC, DrivesEnd, message_at, reading_at

_ENDS = kernels.ends
_MODES = len(DriveMode)
_FRAME = FRAME.itemsize


@helper
def _reject(message: Any) -> int:
    message.kind, message.count = REJECTED, 0
    return 1


@helper
def _parse_sync(e: Any, frame: Any, bus: int, message: Any) -> int:
    counter = np.int64(frame.data[0])
    if frame.length != e.sync_length or not crc.intact(frame) or counter == e.present[bus]:
        return _reject(message)
    e.present[bus] = counter
    message.kind, message.counter, message.count = SYNC, counter, 0
    for leg in range(LEGS):
        if e.home[leg] == bus:
            message.legs[message.count] = leg
            message.count += 1
    return 1


@helper
def _parse_command(e: Any, of: Any, frame: Any, message: Any) -> int:
    """Decode a command; bytes after the checksum, which does not cover them, have to be 0."""
    data, at, width = frame.data, of.check[0] >> 3, of.check[1] >> 3
    if frame.length != of.length or crc.check_of(of.id, data, at, width) != whole(data, at, width):
        return _reject(message)
    for k in range(at + width, of.length):
        if data[k]:
            return _reject(message)
    mode = kernels.natural(data, of.mode[0], of.mode[1])
    if mode >= _MODES:
        return _reject(message)
    word = np.empty(1, np.int64)
    for k in range(of.forces):
        value = kernels.read(data, of.first + k * of.bits, of.bits, word)
        if not e.least <= value <= e.most:
            return _reject(message)
        message.force[k] = value if of.bits == kernels.EXACT else value * e.step
    present, counter = e.present[of.bus], kernels.natural(data, of.counter[0], of.counter[1])
    message.counter = counter
    if present == kernels.NO_SYNC or counter != present & ((1 << of.counter[1]) - 1):
        return _reject(message)
    message.kind, message.mode, message.count = COMMAND, mode, of.legs
    message.legs[:] = of.leg
    return 1


@pointed(_ENDS, INTEGER, INTEGER)
def parse(e: Any, frame_address: int, message_address: int) -> int:
    """Decode a SYNC or a command; FAILED for a CONFIG or an E-stop.

    Rejected: wrong length or checksum, an unknown mode, a force out of range, a command that does not belong
    to the present SYNC, a repetition of the present SYNC.
    """
    frame, message = frame_at(frame_address), message_at(message_address)
    identifier: Any = np.int64(frame.id)
    bus: Any = np.int64(frame.bus)
    if frame.flags & kernels.STRANGE or bus >= e.buses:
        return 0
    if identifier == e.sync:
        return _parse_sync(e, frame, bus, message)
    commands = kernels.commands_at(e.commands, e.frames)
    for n in range(e.frames):
        if identifier == commands[n].id and bus == commands[n].bus:
            return _parse_command(e, commands[n], frame, message)
    return FAILED if identifier == e.estop or place_of(identifier, e.config) >= 0 else 0


@pointed(_ENDS, INTEGER, INTEGER, INTEGER, INTEGER)
def answer(e: Any, sync_address: int, reading_address: int, into: int, senders: int) -> int:
    """Write the feedback frames to a SYNC to address `into` and the leg of each to address `senders`.

    The frames are in leg order on each bus. Values out of range saturate. Returns their number, or FAILED if
    a reading is NaN.
    """
    sync, reading = message_at(sync_address), reading_at(reading_address)
    values = (reading.length, reading.rate, reading.force)
    asked, count, last = 0, 0, e.feedback_length - 1
    for k in range(sync.count):
        asked |= 1 << sync.legs[k]
    for k in range(kernels.QUANTITIES):
        for leg in range(LEGS):
            if e.bits[k] > 0 and np.isnan(values[k][leg]):
                return FAILED
    legs, word = integers_at(senders, LEGS), np.empty(1, np.int64)
    for bus in range(e.buses):
        for leg in range(LEGS):
            if e.home[leg] != bus or not asked >> leg & 1:
                continue
            frame = frame_at(into + count * _FRAME)
            begin_sent(frame, e.feedback[leg], e.feedback_length, e.feedback_flags, bus)
            data = frame.data
            for k in range(kernels.QUANTITIES):
                if e.bits[k] > 0:
                    value = min(max(values[k][leg], e.low[k]), e.high[k])
                    steps = value if e.bits[k] == kernels.EXACT else np.rint(value / e.scale[k])
                    kernels.write(steps, data, e.start[k], e.bits[k], word)
            data[e.counter_at] = reading.state[leg] << 4 | sync.counter & 0xF
            data[last] = crc.check_of(e.feedback[leg], data, last, 1)
            legs[count] = leg
            count += 1
    return count


@pointed(_ENDS, INTEGER, INTEGER, INTEGER, INTEGER, INTEGER, INTEGER, INTEGER)
def report(
    e: Any, leg: int, state: int, fault: int, watchdog_ns: int, reaction: int, _due: int, into: int
) -> int:
    """Write the status frame of one drive to address `into`; returns 1."""
    checksum, last = 0, e.status_length - 1
    if watchdog_ns >= 0:
        watchdog = np.int64(np.rint(watchdog_ns * 1e-9 / e.watchdog_s))
        said = np.empty(11, np.uint8)
        said[4], said[5], said[6] = reaction, e.place[leg], e.version
        for k in range(4):
            said[k], said[7 + k] = watchdog >> 8 * k & 0xFF, e.rated_mN >> 8 * k & 0xFF
        checksum = crc.check_of(e.config[leg], said, 11, 2)
    frame = frame_at(into)
    begin_sent(frame, e.status[leg], e.status_length, e.status_flags, e.home[leg])
    data = frame.data
    data[0], data[1], data[2], data[3] = state, fault, checksum & 0xFF, checksum >> 8
    data[last] = crc.check_of(e.status[leg], data, last, 1)
    return 1


class LegsDrives(DrivesEnd):
    """The drives' end of protocol `legs`. Mutable state: counter of the present SYNC of each bus."""

    def __init__(self, family: Any) -> None:
        self._family = family
        super().__init__(family.tables.copy(), parse, answer, report)

    def converse(self, frame: Frame) -> None:
        """Process an E-stop, whatever its payload, or a CONFIG; reject one of another version or leg."""
        there, config = self._family.legs[frame.bus], self.record["config"].tolist()
        if frame.id not in config:
            self.put(STOP, sorted(there))
            return
        leg, of, data = config.index(frame.id), self._family.config, frame.data
        if len(data) != of.length or crc.check(frame.id, data[:-1], 1) != data[-1]:
            self.put(REJECTED)
            return
        watchdog, reaction, place, version, _ = of.unpack(data)
        ours = version == self.record["version"] and place == self.record["place"][leg]
        if not ours or watchdog < 1 or reaction >= len(Reaction):
            self.put(REJECTED)
        elif leg in there:
            self.put(CONFIGURE, (leg,), reaction, round(watchdog * of.scale[0] * 1e9))
