"""Emulated drives of MIT framing, 11-bit identifiers: mini-cheetah, CubeMars, Damiao with registers."""

import struct
from typing import Any

import numpy as np

from drivers.compiled.compiler import helper
from drivers.frame_pointers import begin_sent, value, whole
from drivers.mit import protocol as k
from drivers.mit.fields import TURN, Ranges
from drivers.protocol import STRANGE, Frame
from drivers.signals import DriveFault, Reaction
from drivers.tick_columns import Record
from plant_fmu.drives import motors as drives
from plant_fmu.drives.codec import CONFIGURE, REJECTED, SYNC

HELD = tuple(k.KIND)
"""Registers of an emulated drive, in the order of its record."""
_TIMEOUT_AT = HELD.index(k.TIMEOUT)
_SPECIAL = (1 << 56) - 1
_ENABLE, _DISABLE, _CLEAR, _ZERO = (each[-1] for each in (k.ENABLE, k.DISABLE, k.CLEAR, k.ZERO))


@helper
def scaled(x: float, end: float, bits: int, clamps: bool) -> int:
    """Code of x in a symmetric field -end..end of `bits` bits, as a drive computes it: may wrap."""
    at = min(max(x, -end), end) if clamps else x
    return int((at + end) * ((1 << bits) - 1) / (2.0 * end))


@helper
def device_motion(
    position: float, velocity: float, torque: float, r: Ranges, clamps: bool
) -> tuple[int, int, int, int, int]:
    """Bytes 1 to 5 of a reply, with position rad, velocity rad/s and torque N m as a drive packs them.

    Without clamping, as in Katz's firmware, a position out of range wraps, the velocity loses its high bits,
    and the torque carries into the low bits of the velocity.
    """
    p = scaled(position, r.position, 16, clamps)
    v = scaled(velocity, r.velocity, 12, clamps)
    t = scaled(torque, r.torque, 12, clamps)
    return p >> 8 & 0xFF, p & 0xFF, v >> 4 & 0xFF, ((v & 0xF) << 4) + (t >> 8) & 0xFF, t & 0xFF


@drives.obeying
def obey(d: Any, leg: int, frame: Any, messages: int) -> int:
    """Execute a command as MESSAGEs, with an answer of feedback; result: see `plant_fmu.drives.motors`."""
    ear, data, count = drives.ear_at(d.ear), frame.data, 0
    if frame.flags & STRANGE & ~ear.flags:
        return 0
    if frame.length != 8:
        return drives.rejects(leg, messages)
    special = int(data[7]) if whole(data, 0, 7) == _SPECIAL else 0
    if special == _ZERO:
        count = drives.rejects(leg, messages)  # not emulated
    elif special == _ENABLE:
        if not d.enabled[leg]:
            # factory setting if no controller has changed it
            ticks = d.registers[leg, _TIMEOUT_AT] if ear.registers else 0.0
            watchdog_ns: Any = d.watchdog_ns
            if ticks > 0.0:
                watchdog_ns = np.int64(np.rint(ticks / k.TICKS_PER_S * 1e9))
            count = drives.configures(d, leg, watchdog_ns, messages, 0)
            count = drives.enables(d, leg, 0.0, messages, count)
    elif special == _DISABLE:
        count = drives.commands(d, leg, drives.OFF, 0.0, messages, 0)
        if not ear.registers:
            count = drives.configures(d, leg, d.watchdog_ns, messages, count)
    elif special == _CLEAR and ear.registers:
        count = drives.commands(d, leg, drives.RESET, 0.0, messages, 0)
    elif d.enabled[leg]:
        number = (int(data[6]) & 0xF) << 8 | int(data[7])
        torque = value(number, -ear.torque, ear.torque, 12)
        count = drives.commands(d, leg, drives.RUN, torque, messages, 0)
    return drives.answers(leg, messages, count)


@drives.encoding
def encode(d: Any, said: Any, frame: Any) -> int:
    """Fill in a reply frame. A lost encoder reads the lower end, as no field can report the loss."""
    ear, leg = drives.ear_at(d.ear), said.leg
    begin_sent(frame, ear.replies[leg], ear.longest, ear.flags, d.bus_of[leg])
    data, node = frame.data, d.nodes[leg]
    position = -ear.position if said.lost else said.turns * TURN
    motion = device_motion(position, said.speed * TURN, said.torque, ear, ear.clamps != 0)
    for n in range(5):
        data[1 + n] = motion[n]
    if ear.registers:
        status = said.code or said.runs
        data[0], data[6], data[7] = status << 4 | node, 30, 30
    elif ear.longest == 8:
        data[0], data[6], data[7] = node, 30, said.code
    else:
        data[0], data[6] = node, 0x99
    return 0


class MitDrives(drives.MotorDrives):
    """Six emulated drives of one variant of MIT framing."""

    obey, encode = obey, encode

    def __init__(self, family: Any) -> None:
        self.codes = CODES.get(family.variant, {})
        super().__init__(family)

    def power_up(self, d: Record) -> None:
        """Set the registers of six drives to their factory values."""
        r = self.family.ranges
        for leg, node in enumerate(self.family.nodes):
            d["registers"][leg, : len(HELD)] = 0, 0, r.position, r.velocity, r.torque, node, 1

    def request(self, leg: int | None, frame: Frame) -> None:
        """Process a request for a register of a Damiao drive."""
        data = frame.data
        if frame.flags & STRANGE & ~self.family.flags:
            return
        if len(data) == 8 and data[2] == k.REFRESH and leg is not None:
            self.put(SYNC, (leg,))
        elif (
            len(data) != 8
            or data[2] not in (k.READ, k.WRITE)
            or data[3] not in k.KIND
            or (data[2] == k.WRITE and data[3] in k.SAID)
        ):
            self.put(REJECTED)
        elif leg is not None:
            self._take_register(leg, data)

    def _take_register(self, leg: int, data: bytes) -> None:
        register, kind, held = HELD.index(data[3]), k.KIND[data[3]], self.record["registers"][leg]
        if data[2] == k.WRITE:
            (held[register],) = struct.unpack(kind, data[4:])
            if data[3] == k.TIMEOUT and held[register] > 0:
                self.put(CONFIGURE, (leg,), Reaction.BRAKE, round(held[register] / k.TICKS_PER_S * 1e9))
        body = struct.pack(kind, int(held[register]) if kind == "<I" else held[register])
        self.say(leg, Frame(self.family.replies[leg], data[:4] + body, self.family.flags))


CODES = {
    "cubemars": {DriveFault.OVERFORCE: 2, DriveFault.SENSOR: 5},
    "damiao": {
        DriveFault.WATCHDOG: 13,
        DriveFault.OVERFORCE: 10,
        DriveFault.SENSOR: 8,
        DriveFault.STROKE: 14,
    },
    "robstride": {DriveFault.OVERFORCE: 2, DriveFault.SENSOR: 8, DriveFault.STROKE: 16},
}
"""Fault code that an emulated drive sends, by variant and fault."""
