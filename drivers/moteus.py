"""moteus: registers over CAN FD, the query in the frame of the command, both ends.

Identifier: source << 8 | destination, bit 15 where a reply is wanted; extended where it is over 0x7FF, so
commands are, and replies of the ids from 8 on. A frame is subframes, little-endian: 0x00, 0x04, 0x08, 0x0C
write int8, int16, int32, float from a register on, 0x10 to 0x1C read, 0x20 to 0x2C reply; the low two bits
count registers, or are 0 and a count follows. NOP 0x50 fills up. Torque goes as feed-forward of position mode
without position and gains. Every such command carries the time after which the drive gives up (mode 11, until
a stop), and a stop clears faults: outside RUN the polls are stops. A drive that restarts obeys the
next command. Source: the reference of the moteus protocol (mjbots), and the package `moteus` 1.1.1.
"""

import struct
from bisect import bisect_left
from collections.abc import Sequence
from math import isnan, nan

import numpy as np

from drivers.arrays import Array, Ints
from drivers.config import BusSettings, DriveSettings
from drivers.errors import ConfigurationError
from drivers.motor_drives import MotorMemory, put
from drivers.motor_settings import Options, refuse_layout, refuse_torque, required
from drivers.motors import (
    OWN_CODE,
    Exchange,
    Heard,
    MotorDialogue,
    MotorProtocol,
)
from drivers.protocol import (
    BRS,
    ERROR,
    EXTENDED,
    FD,
    OTHER_BUSES,
    REMOTE,
    Configure,
    DeviceMessage,
    DriveSetup,
    Frame,
    Rejected,
    Sync,
)
from drivers.signals import INVALID, LEGS, DriveFault, DriveMode, DriveState, Reaction
from drivers.transmission import Transmission

REPLY = 0x8000
"""Bit of an identifier: a reply is wanted."""
NOP = 0x50
STOPPED, FAULTED, POSITION, TIMED_OUT = 0, 1, 10, 11
"""Modes."""
MODE, PLACE, SPEED, TORQUE, FAULT, TIMEOUT, COMMAND = 0x000, 0x001, 0x002, 0x003, 0x00F, 0x027, 0x020
"""Registers; COMMAND begins position, velocity, feed-forward torque, scales of kp and kd, most torque."""
QUERY = bytes.fromhex("11001f01130d")
"""Read the mode as int8; position, velocity, torque as floats; voltage, temperature, fault as int8."""
DEFAULT_TIMEOUT_S = 0.1
"""`servo.default_timeout_s` as delivered."""
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
_CODES = {DriveFault.OVERFORCE: 33, DriveFault.SENSOR: 35, DriveFault.STROKE: 39}
_SIZES = (1, 2, 4, 4)
_FORMS = ("b", "h", "i", "f")
_SCALES = {PLACE: (0.01, 0.0001, 0.00001), SPEED: (0.1, 0.00025, 0.00001), TORQUE: (0.5, 0.01, 0.001)}
"""Of an int8, int16, int32."""
_LENGTHS = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)
_STRANGE = REMOTE | ERROR | OTHER_BUSES
_OFF, _RUN, _FAULT = DriveState.OFF, DriveState.RUN, DriveState.FAULT
_MAX_TORQUE = 1e4


def pad(data: bytes) -> bytes:
    """Return the data filled up to the next length of CAN FD."""
    return data + bytes((NOP,)) * (_LENGTHS[bisect_left(_LENGTHS, len(data))] - len(data))


def registers(data: bytes, kind: int) -> dict[int, float] | None:
    """Return what the subframes of a kind (0x00 write, 0x20 reply) hold, NaN for what is not known.

    Registers without a scale come as they are. Errors (0x30, 0x31) end the frame. None if it is not whole.
    """
    found: dict[int, float] = {}
    at = 0
    try:
        while at < len(data):
            head = data[at]
            at += 1
            if head == NOP:
                continue
            if head & 0xF0 == 0x30:
                break
            width, count = head >> 2 & 3, head & 3
            if count == 0:
                count, at = data[at], at + 1
            first, at = data[at], at + 1
            if head & 0xF0 == 0x10:
                continue
            if head & 0xF0 != kind or first + count > 0x80 or at + count * _SIZES[width] > len(data):
                return None
            for k, raw in enumerate(struct.unpack_from(f"<{count}{_FORMS[width]}", data, at)):
                found[first + k] = _value(first + k, width, raw)
            at += count * _SIZES[width]
    except IndexError:
        return None
    return found


def _value(register: int, width: int, raw: float) -> float:
    scales = _SCALES.get(register)
    if width == 3 or scales is None:
        return float(raw)
    return nan if raw == -(1 << (8 * _SIZES[width] - 1)) else raw * scales[width]


def torque_command(torque: float, most: float, timeout_s: float) -> bytes:
    """Return a command of torque N m with its limit N m, its watchdog s and the query, not filled up."""
    values = struct.pack("<6f", nan, 0.0, torque, 0.0, 0.0, most)
    return b"\x01\0\x0a\x0c\x06\x20" + values + b"\x0d\x27" + struct.pack("<f", timeout_s) + QUERY


STOP = pad(b"\x01\0\0" + QUERY)


class MoteusProtocol(MotorProtocol):
    """The tables of six drives."""

    set_up_frames = 0
    reset_ticks = 3
    shares_identifiers = False

    def __init__(
        self, nodes: Sequence[int], host: int, timeout_mode: Reaction, most: float, transmission: Transmission
    ) -> None:
        """Take six ids, the controller's, what `servo.timeout_mode` does, and the most torque, N m.

        Raises ConfigurationError for ids that a frame cannot carry.
        """
        super().__init__(transmission)
        for leg, node in enumerate(nodes):
            if not 1 <= node <= 126 or node == host:
                raise ConfigurationError(
                    f"drives.node_ids[{leg}]: out of range, allowed with moteus: 1 to 126 but the "
                    f"controller's {host}, given: {node}"
                )
        if not 0 <= host <= 126:
            raise ConfigurationError(
                f"drives.options: host_id out of range, allowed: 0 to 126, given: {host}"
            )
        self.reactions, self._most = (timeout_mode,), most
        self._command_ids = tuple(REPLY | host << 8 | node for node in nodes)
        self._reply_ids = tuple(node << 8 | host for node in nodes)
        self._commanded_legs = {identifier: leg for leg, identifier in enumerate(self._command_ids)}
        self._answering_legs = {identifier: leg for leg, identifier in enumerate(self._reply_ids)}
        self.feedback_ids = frozenset(self._reply_ids)

    @property
    def torque_limit(self) -> float:
        """N m."""
        return self._most

    @property
    def brake_danger(self) -> str:
        """A pin that a register writes keeps its level when the controller falls silent."""
        return (
            "drives.protocol: a moteus has no brake output, and its aux pins keep their level when it faults "
            "or its time is over, so none of them is used: a platform without power falls unless brakes of "
            "your own close by themselves when a drive is stopped; the brake tests test those"
        )

    @property
    def watchdog_danger(self) -> str:
        """What it does is the drive's own setting."""
        does = "0, stopped" if self.reactions == (Reaction.BRAKE,) else "12, zero velocity"
        return (
            f"drives.options: what a drive does when its time is over is its own servo.timeout_mode; set "
            f"it to {does} with moteus_tool, as nothing here reads it back"
        )

    def fault_text(self, code: int) -> str:
        """Return what a code of the column `drive_fault` means."""
        return FAULTS.get(code - OWN_CODE, "")

    # controller's end

    def exchanges(self, _setup: DriveSetup) -> tuple[tuple[Exchange, ...], ...]:
        """Return nothing: every command carries what it needs."""
        return ((),) * LEGS

    def awaited(self, frame: Frame) -> int:
        """Return the identifier of a reply, -1 for what is none."""
        return frame.id if super().awaited(frame) >= 0 else -1

    def poll(self, dialogue: MotorDialogue, leg: int) -> Frame:
        """Return a torque with its query, or a stop with its query."""
        data = STOP
        if dialogue.mode == DriveMode.RUN:
            data = pad(torque_command(dialogue.torque[leg], self._most, dialogue.watchdog_s))
        return Frame(self._command_ids[leg], data, EXTENDED | FD | BRS)

    def hear(self, frame: Frame) -> Heard | None:
        """Return what a reply says."""
        identifier, data, flags = frame
        if flags & _STRANGE or not flags & FD:
            return None
        if bool(flags & EXTENDED) != (identifier > 0x7FF):
            return None
        if identifier in self._commanded_legs:
            return Heard(self._commanded_legs[identifier], foreign=True)
        leg = self._answering_legs.get(identifier)
        if leg is None:
            return None
        said = registers(data, 0x20)
        if said is None or not {MODE, PLACE, SPEED, TORQUE, FAULT} <= said.keys():
            return Heard(leg, broken=True)
        mode, fault = int(said[MODE]), 0
        power = _RUN if mode == POSITION else _OFF
        if mode in (FAULTED, TIMED_OUT):
            power = _FAULT
            fault = int(DriveFault.WATCHDOG) if mode == TIMED_OUT else OWN_CODE + int(said[FAULT])
        motion = None if isnan(said[PLACE]) or isnan(said[SPEED]) else (said[PLACE], said[SPEED])
        torque = None if isnan(said[TORQUE]) else said[TORQUE]
        return Heard(leg, motion=motion, feedback=True, torque=torque, power=power, fault=fault)

    def emergency_stop(self) -> tuple[Frame, ...]:
        """Return a stop for each drive: it does not latch."""
        return tuple(Frame(each, STOP, EXTENDED | FD | BRS) for each in self._command_ids)

    # drives' end

    def parse(self, memory: MotorMemory, frame: Frame) -> tuple[MotorMemory, tuple[DeviceMessage, ...]]:
        """Decode at the drives' end; a frame that asks is answered."""
        leg = self._commanded_legs.get(frame.id)
        if leg is None or frame.flags & _STRANGE or not frame.flags & EXTENDED or not frame.flags & FD:
            return memory, ()
        written = registers(frame.data, 0x00)
        if written is None:
            return memory, (Rejected("subframes that are not whole"),)
        after, torque, mode = memory.enabled[leg], 0.0, written.get(MODE)
        modes: tuple[int, ...] = ()
        settings: tuple[DeviceMessage, ...] = ()
        if mode == STOPPED:
            modes, after = (DriveMode.RESET,), False
            settings = (Configure(leg, DEFAULT_TIMEOUT_S, self.reactions[0]),)
        elif mode == POSITION:
            torque = written.get(COMMAND + 2, nan)
            most, timeout_s = written.get(COMMAND + 5, nan), written.get(TIMEOUT, nan)
            if isnan(torque) or most <= 0.0 or written.get(COMMAND + 3) or written.get(COMMAND + 4):
                return memory, (Rejected("position mode that is no torque command"),)
            torque = min(max(torque, -most), most) if most > 0.0 else torque
            if not after:
                limit_s = timeout_s if timeout_s > 0.0 else DEFAULT_TIMEOUT_S
                settings = (Configure(leg, limit_s, self.reactions[0]),)
            modes, after = ((DriveMode.RUN,) if after else (DriveMode.READY, DriveMode.RUN)), True
        elif mode is not None:
            return memory, (Rejected(f"mode {mode:g}"),)
        memory, commands = self._commanded(memory, leg, modes, torque)
        memory = memory._replace(enabled=put(memory.enabled, leg, after))
        first, last = (settings, ()) if mode == POSITION else ((), settings)
        return memory, (*first, *commands, *last, Sync(0, (leg,)))

    def answer(
        self,
        memory: MotorMemory,
        sync: Sync,
        length: Array,
        rate: Array,
        force: Array,
        state: Ints,
        fault: Ints | None = None,
    ) -> tuple[MotorMemory, list[tuple[int, Frame]]]:
        """Encode what the drives of `sync.legs` answer to QUERY: 24 V, 30 degrees; a lost encoder is NaN."""
        codes = np.zeros(LEGS, np.int64) if fault is None else fault
        turns, speeds, torques = self.motor(length, rate, force)
        frames = []
        for leg in sync.legs:
            self.finite(leg, turns[leg], speeds[leg], torques[leg])
            said, why = int(state[leg]) & ~INVALID, DriveFault(int(codes[leg]))
            mode, code = POSITION if said == _RUN else STOPPED, 0
            if said == _FAULT:
                mode = TIMED_OUT if why is DriveFault.WATCHDOG else FAULTED
                code = 0 if mode == TIMED_OUT else _CODES.get(why, 33)
            values = (nan, nan) if int(state[leg]) & INVALID else (turns[leg], speeds[leg])
            floats = struct.pack("<3f", *values, torques[leg])
            data = bytes((0x21, MODE, mode, 0x2F, PLACE)) + floats + bytes((0x23, 0x0D, 48, 30, code))
            identifier = self._reply_ids[leg]
            frames.append((leg, Frame(identifier, pad(data), FD | BRS | EXTENDED * (identifier > 0x7FF))))
        return memory, frames

    # bus time

    def cyclic_frames(self) -> tuple[Frame, ...]:
        """Return one example of every frame of a tick: six torques, six replies."""
        data = pad(torque_command(0.0, 1.0, 1.0))
        commands = (Frame(each, data, EXTENDED | FD | BRS) for each in self._command_ids)
        return (*commands, *self.example_feedbacks())


_TIMEOUT_MODES = {"stopped": Reaction.BRAKE, "zero_velocity": Reaction.DAMP}


def moteus(bus: BusSettings, drives: DriveSettings) -> MoteusProtocol:
    """Return the codec of a configuration. Raises ConfigurationError for settings that it does not have."""
    refuse_layout(bus, "moteus", "fd")
    transmission = required(drives.transmission, "moteus")
    options = Options(drives.options, "moteus", ("host_id", "timeout_mode", "torque_N_m"))
    mode = _TIMEOUT_MODES[options.choice("timeout_mode", tuple(_TIMEOUT_MODES))]
    most = options.positive("torque_N_m", _MAX_TORQUE)
    refuse_torque(transmission, drives.force_limit_N, most, "moteus")
    return MoteusProtocol(drives.node_ids, options.whole("host_id", 0), mode, most, transmission)
