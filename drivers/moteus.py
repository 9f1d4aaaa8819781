"""Codec of moteus drives: registers over CAN FD; a command frame also queries the drive.

Identifier: source << 8 | destination, bit 15 if a reply is wanted. It is extended above 0x7FF, as for
commands and for replies of ids from 8 on. Torque is sent as feed-forward of position mode, without position
and gains. Every such command carries the time after which the drive gives up (mode 11, until a stop). A stop
clears faults: outside RUN the polls are stops. A restarted drive obeys the next command and may answer as
enabled: then the restart goes unnoticed. A drive that reports being stopped gets no command until RUN is
requested again. Source: the reference of the moteus protocol (mjbots), and the package `moteus` 1.1.1.
Subframes are mjlib multiplex: a head with kind, width (int8, int16, int32, float) and count, 0 for a count
that follows; counts and registers are varuints, values little-endian. The smallest integer of a width means
"not known".
"""

import struct
from bisect import bisect_left
from functools import cached_property
from math import nan
from typing import Any

import numpy as np

from drivers import motor_kernels as motors
from drivers.arrays import Array
from drivers.can.bus_time import FD_LENGTHS
from drivers.compiled.compiler import helper
from drivers.config import BusSettings, DriveSettings
from drivers.frame_pointers import place_of, signed, whole
from drivers.motor_kernels import FALLS, OWN_CODE
from drivers.motor_settings import Options, refuse_torque
from drivers.motors import MotorProtocol
from drivers.protocol import BRS, ERROR, EXTENDED, FD, REMOTE, REVISION, SERIAL, Frame, Said, Traits
from drivers.signals import DriveFault, DriveState, Reaction

NOP = 0x50
WRITE, READ, REPLY, ERRORS = 0x00, 0x10, 0x20, 0x30
"""Kinds of subframes."""
PADDING = 0x50
"""First kind of no subframe: some interfaces pad with 0xCC, not with NOP."""
NOT_WHOLE, NOTHING = -1, -2
"""Instead of a kind: the data end within a group, or no group is left."""
_MOST_BITS = 63
"""Most bits of a number; no register and no count is as large."""
MODE, PLACE, SPEED, TORQUE = 0x000, 0x001, 0x002, 0x003
TRAJECTORY_COMPLETE, HOME_STATE, VOLTAGE, TEMPERATURE, FAULT = 0x00B, 0x00C, 0x00D, 0x00E, 0x00F
COMMAND, TIMEOUT = 0x020, 0x027
"""COMMAND is the first of: position, velocity, feed-forward torque, scales of kp and kd, largest torque."""
FIRMWARE, SERIAL_NUMBER = 0x101, 0x120
"""SERIAL_NUMBER is the first of three registers of 32 bits, lowest word first."""
FLOAT = 3
SIZES = (1, 2, 4, 4)
"""Bytes of a value, by its width."""


def pad(data: bytes) -> bytes:
    """Data padded with NOP to the next length that CAN FD allows."""
    return data + bytes((NOP,)) * (FD_LENGTHS[bisect_left(FD_LENGTHS, len(data))] - len(data))


@helper
def _varuint(data: Any, size: int, at: int) -> tuple[int, int]:
    """(varuint, seven bits per byte, at index `at`; index after it); NOT_WHOLE if the data end before."""
    number = shift = 0
    while at < size:
        byte = int(data[at])
        at += 1
        if shift < _MOST_BITS:
            number |= (byte & 0x7F) << shift
        elif byte & 0x7F:
            number |= 1 << (_MOST_BITS - 1)
        shift += 7
        if byte < 0x80:
            return number, at
    return 0, NOT_WHOLE


@helper
def group(data: Any, size: int, at: int) -> tuple[int, int, int, int, int]:
    """(kind, width, first register, count, index of the first value) of the register group at index `at`.

    Kind NOTHING: an empty group; ERRORS: the end of the frame; NOT_WHOLE: the data end within the group.
    """
    head = int(data[at])
    at += 1
    kind, width, count = head & 0xF0, head >> 2 & 3, head & 3
    if head == NOP:
        return NOTHING, width, 0, 0, at
    if kind == ERRORS or kind >= PADDING:
        return ERRORS, width, 0, 0, at
    if count == 0:
        count, at = _varuint(data, size, at)
        if count == 0:
            return NOTHING if at >= 0 else NOT_WHOLE, width, 0, 0, at
    first, at = _varuint(data, size, at)
    return kind if at >= 0 else NOT_WHOLE, width, first, count, at


@helper
def scale_of(register: int, width: int) -> float:
    """Value of one count at an integer width: turns, turns/s, N m, V, degC or s; 0: unscaled register."""
    if width == FLOAT:
        return 0.0
    if register in (PLACE, COMMAND):
        return (0.01, 0.0001, 0.00001)[width]
    if register in (SPEED, COMMAND + 1):
        return (0.1, 0.00025, 0.00001)[width]
    if register in (TORQUE, COMMAND + 2, COMMAND + 5):
        return (0.5, 0.01, 0.001)[width]
    if register == VOLTAGE:
        return (0.5, 0.1, 0.001)[width]
    if register == TEMPERATURE:
        return (1.0, 0.1, 0.001)[width]
    return (0.01, 0.001, 0.000001)[width] if register == TIMEOUT else 0.0


@helper
def value(register: int, width: int, raw: float) -> float:
    """Physical value of a register's raw number at that width; NaN if the drive does not know it."""
    scale = scale_of(register, width)
    if scale == 0.0:
        return float(raw)
    return nan if raw == -(1 << (8 * SIZES[width] - 1)) else raw * scale


ALL_NODES = 0x7F
"""Destination of a frame for all drives."""
STOPPED, FAULTED, POSITION, TIMED_OUT = 0, 1, 10, 11
"""Modes of a moteus."""
STRANGE = REMOTE | ERROR
_REGISTERS = *range(MODE, TORQUE + 1), FAULT, FIRMWARE, *range(SERIAL_NUMBER, SERIAL_NUMBER + 3)
"""Registers of a drive that are read."""
_MODE, _PLACE, _SPEED, _TORQUE, _FAULT_CODE, _FIRMWARE, _SERIAL = range(7)
_STATE = 0b11111
"""Bits of the first five of them."""
REPLY_WANTED = 0x8000
"""Bit of an identifier that requests a reply."""


@helper
def read(data: Any, size: int, of: int, names: tuple[int, ...], values: Array) -> int:
    """Read registers `names` from subframes of kind `of` into `values`.

    Bit k of the result is set if names[k] was found; -1: the data are incomplete or of another kind.
    """
    has = at = 0
    while at < size:
        kind, width, first, count, at = group(data, size, at)
        if kind == ERRORS:
            break
        if kind in (NOTHING, READ):
            continue
        wide = SIZES[width]
        if kind != of or count > size or at + count * wide > size:
            return -1
        for k in range(len(names)):
            place = names[k] - first
            if 0 <= place < count:
                start = at + place * wide
                if width == FLOAT:
                    raw = motors.single(data, start)
                else:
                    raw = float(signed(whole(data, start, wide), 8 * wide))
                values[k] = value(names[k], width, raw)
                has |= 1 << k
        at += count * wide
    return has


@helper
def _is_whole(number: float) -> bool:
    return bool(np.isfinite(number) and number == np.floor(number))


@helper
def _names_drive(has: int, values: Array) -> bool:
    if has >> _FIRMWARE & 1:
        return _is_whole(values[_FIRMWARE])
    for k in range(_SERIAL, _SERIAL + 3):  # noqa: SIM110 - compiled
        if not (has >> k & 1 and _is_whole(values[k])):
            return False
    return True


@motors.hearing
def hear(ear: Any, frame: Any, heard: Any) -> int:
    """Decode a reply into `heard` (HEARD record); 0: not a reply of a known drive."""
    identifier = int(frame.id)
    if frame.flags & STRANGE or not frame.flags & FD:
        return 0
    if (frame.flags & EXTENDED != 0) != (identifier > 0x7FF):
        return 0
    to = place_of(identifier & ALL_NODES, ear.nodes)
    if identifier <= 0xFFFF and (to >= 0 or identifier & ALL_NODES == ALL_NODES):
        return motors.says(heard, max(to, 0), motors.FOREIGN)
    leg = place_of(identifier, ear.replies)
    if leg < 0:
        return 0
    values = np.zeros(len(_REGISTERS))
    has = max(read(frame.data, int(frame.length), REPLY, _REGISTERS, values), 0)
    if has & _STATE != _STATE:
        return motors.says(heard, leg, 0 if _names_drive(has, values) else motors.BROKEN)
    place, speed, torque = values[_PLACE], values[_SPEED], values[_TORQUE]
    broken = np.isinf(place) or np.isinf(speed) or np.isinf(torque)
    for number in (values[_MODE], values[_FAULT_CODE]):  # both are requested as int8
        broken = broken or not (0.0 <= number < 128.0 and _is_whole(number))
    if broken:
        return motors.says(heard, leg, motors.BROKEN)
    mode = int(values[_MODE])
    motors.says(heard, leg, motors.FEEDBACK | motors.POWER)
    heard.power = DriveState.RUN.value if mode == POSITION else DriveState.OFF.value
    if mode in (FAULTED, TIMED_OUT):
        heard.power = DriveState.FAULT.value
        heard.fault = DriveFault.WATCHDOG.value if mode == TIMED_OUT else OWN_CODE + int(values[_FAULT_CODE])
    if not (np.isnan(place) or np.isnan(speed)):
        heard.has |= motors.MOTION
        heard.turns, heard.speed = place, speed
    if not np.isnan(torque):
        heard.has |= motors.TORQUE
        heard.torque = torque
    return 1


QUERY = bytes.fromhex("11001f01130d")
"""Read mode as int8; position, velocity, torque as floats; voltage, temperature, fault as int8."""
WHO, WHICH = bytes.fromhex("1ba002"), bytes.fromhex("198102")
"""Read the serial number; read the firmware version; each as int32."""
DEFAULT_TIMEOUT_S = 0.1
"""Factory setting of `servo.default_timeout_s`."""
FAULTS = {
    32: "calibration fault",
    33: "motor driver fault",
    34: "over voltage",
    35: "encoder fault",
    36: "motor not configured",
    37: "PWM cycle overrun",
    38: "over temperature",
    39: "outside limit",
    40: "under voltage",
    41: "configuration changed",
    42: "theta invalid",
    43: "position invalid",
    44: "driver enable fault",
    45: "stop position, deprecated",
    46: "timing violation",
    47: "no acceleration for feed-forward of the back-EMF",
    48: "invalid limits",
    49: "position control error",
    50: "velocity control error",
}
_WORD = 0xFFFFFFFF
_MAX_TORQUE = 1e4
_BRAKES = (
    "drives.protocol: a moteus has no brake output, and its aux pins keep their level after a fault "
    "or timeout, so none of them is used: a platform without power falls unless it has brakes of its "
    "own that close when a drive stops; the brake tests check them"
)
_TIMEOUT_MODE = (
    "drives.options: the reaction of a drive to its timeout is its own servo.timeout_mode; set "
    "it to {} with moteus_tool, as no frame here reads it back"
)


def torque_command(torque: float, most: float, timeout_s: float) -> bytes:
    """Command data: torque N m, torque limit N m, watchdog s, and the query; not padded."""
    values = struct.pack("<6f", nan, 0.0, torque, 0.0, 0.0, most)
    return b"\x01\0\x0a\x0c\x06\x20" + values + b"\x0d\x27" + struct.pack("<f", timeout_s) + QUERY


TORQUE_AT = 14
"""Index of the first torque byte in a command."""
STOP = pad(b"\x01\0\0" + QUERY)
_ANSWER = pad(b"\x21\0\x0a\x2f\x01" + bytes(12) + b"\x23\x0d\0\0\0")
"""An example of an answer to QUERY."""
_TIMEOUT_MODES = {"stopped": Reaction.BRAKE, "zero_velocity": Reaction.DAMP}


class MoteusProtocol(MotorProtocol):
    """Codec of six moteus drives."""

    ear, rule = hear, FALLS
    number_at, delivered_s = (0, ALL_NODES), DEFAULT_TIMEOUT_S
    fault_names = FAULTS

    def __init__(self, bus: BusSettings, drives: DriveSettings) -> None:
        options = Options(bus, drives, "moteus", "fd", ("host_id", "timeout_mode", "torque_N_m", "brs"))
        transmission, nodes = options.transmission, drives.node_ids
        self._reaction = _TIMEOUT_MODES[options.choice("timeout_mode", tuple(_TIMEOUT_MODES))]
        self.torque_limit = most = options.positive("torque_N_m", _MAX_TORQUE)
        name = f"moteus, by drives.options: torque_N_m {most:g},"
        refuse_torque(transmission, drives.force_limit_N, most, name)
        self.host = host = options.whole("host_id", 0, 0, 126)
        self.flags = FD | BRS * options.flag("brs", default=True)
        """Flags of all frames, but for EXTENDED: a drive answers with the bit rates of its query."""
        answers = tuple(node << 8 | host for node in nodes)
        super().__init__(transmission, nodes, (TORQUE_AT, 32, 0.0), bus.legs, answers)
        self.refuse_nodes(1, 126, "moteus", f" but the controller's {host}", host)
        self.tables["replies"], self.tables["flags"] = answers, self.flags

    # controller's end

    @cached_property
    def traits(self) -> Traits:
        """Properties of moteus drives: they answer each command at once; a stop does not latch."""
        does = "0, stopped" if self._reaction == Reaction.BRAKE else "12, zero velocity"
        return self.traits_of(
            (Frame(each, _ANSWER, self.flags | (EXTENDED if each > 0x7FF else 0)) for each in self.wanted),
            family="moteus",
            emergency_stop=self._commands(STOP),
            identity_requests=tuple(self._commands(pad(ask)) for ask in (WHO, WHICH)),
            command_delay_ticks=1,
            reactions=(self._reaction,),
            dangers=(_BRAKES, _TIMEOUT_MODE.format(does)),
        )

    def requests(self, watchdog_s: float) -> tuple[tuple[Frame, ...], ...]:
        """Frames by purpose: a stop for all requests but torque, and torque; each with the query."""
        torque = pad(torque_command(0.0, self.torque_limit, watchdog_s))
        return tuple(self._commands(data) for data in (STOP, STOP, STOP, torque))

    def _commands(self, data: bytes) -> tuple[Frame, ...]:
        first, flags = REPLY_WANTED | self.host << 8, EXTENDED | self.flags
        return self.to_each(Frame(first | node, data, flags) for node in self.nodes)

    def said_by(self, frame: Frame) -> Said | None:
        """96-bit serial number, or the firmware version as the revision; None for any other frame."""
        identifier, data, flags = frame
        if identifier not in self.wanted or flags & (STRANGE | FD) != FD:
            return None
        values = np.full(1 + 3, nan)
        has = read(data, len(data), REPLY, (FIRMWARE, *_REGISTERS[_SERIAL:]), values)
        words = values.tolist()[:1] if has & 1 else values.tolist()[1:]
        strays = has < 0 or bool(flags & EXTENDED) != (identifier > 0x7FF)
        if strays or not all(map(float.is_integer, words)):
            return None
        number = sum((int(word) & _WORD) << 32 * k for k, word in enumerate(words))
        return Said(self.wanted.index(identifier), REVISION if has & 1 else SERIAL, number)
