"""MIT framing on 11-bit identifiers: mini-cheetah, CubeMars and Damiao, both ends.

A command to a drive is its poll; it answers with position, velocity and torque. Gains are sent as zero: the
law is the controller's. Special frames are seven FF and FC enable, FD disable, FE zero (never sent), FB clear
the fault (Damiao). Damiao alone reports whether it is enabled, and has registers: control mode, the limit of
silence in units of 50 us, and the ranges, which are compared with the configured ones.
"""

import struct
from collections.abc import Sequence

import numpy as np

from drivers.arrays import Array, Ints
from drivers.errors import ConfigurationError, ProtocolError
from drivers.identity import REVISION, SERIAL, Said
from drivers.mit.fields import (
    TOP_COMMAND,
    TURN,
    Ranges,
    device_motion,
    pack_command,
    resolution,
    unpack_command,
    unpack_motion,
)
from drivers.mit.variants import DRIVE_FAULT_CODES, VARIANTS
from drivers.motor_drives import MotorMemory, put
from drivers.motor_settings import unwatched
from drivers.motors import (
    OWN_CODE,
    Exchange,
    Heard,
    MotorDialogue,
    MotorProtocol,
)
from drivers.protocol import (
    ERROR,
    EXTENDED,
    FD,
    OTHER_BUSES,
    REMOTE,
    Answer,
    Configure,
    DeviceMessage,
    DriveSetup,
    Frame,
    Rejected,
    Sync,
)
from drivers.resolution import Resolution
from drivers.signals import INVALID, LEGS, DriveFault, DriveMode, DriveState, Reaction
from drivers.transmission import Transmission

ENABLE, DISABLE, CLEAR, ZERO = (b"\xff" * 7 + bytes((last,)) for last in (0xFC, 0xFD, 0xFB, 0xFE))
STRANGE = EXTENDED | FD | REMOTE | ERROR | OTHER_BUSES
REGISTERS = 0x7FF
"""Identifier of Damiao's requests."""
READ, WRITE, REFRESH = 0x33, 0x55, 0xCC
TIMEOUT, CTRL_MODE, SW_VER, SN, PMAX, VMAX, TMAX = 9, 10, 14, 15, 21, 22, 23
TICKS_PER_S = 20_000
"""Of Damiao's TIMEOUT."""
NO_WATCHDOG_S = 1e6
_OFF, _RUN, _FAULT = DriveState.OFF, DriveState.RUN, DriveState.FAULT


class MitProtocol(MotorProtocol):
    """One variant's tables."""

    def __init__(
        self, variant: str, ranges: Ranges, nodes: Sequence[int], host: int, transmission: Transmission
    ) -> None:
        """Take the variant's name, the ranges, six identifiers, and the reply's: Damiao's less the node's.

        Raises ConfigurationError for nodes that the frames cannot tell apart.
        """
        super().__init__(transmission)
        self.name, self.variant, self.ranges = variant, VARIANTS[variant], ranges
        self.damiao = variant == "damiao"
        self.set_up_frames = 1 if self.damiao else 0
        self.reports_power = self.has_watchdog = self.damiao
        self._codes = DRIVE_FAULT_CODES.get(variant, {})
        most = 15 if self.damiao else 127
        for leg, node in enumerate(nodes):
            if not 1 <= node <= most:
                raise ConfigurationError(
                    f"drives.node_ids[{leg}]: out of range, allowed with variant {variant}: 1 to {most}, "
                    f"as its reply names the node, given: {node}"
                )
        self._nodes = tuple(nodes)
        self._legs = {node: leg for leg, node in enumerate(nodes)}
        self._replies = [node + host if self.damiao else host for node in nodes]
        for reply in self._replies:
            if not 0 <= reply < REGISTERS or reply in self._legs:
                raise ConfigurationError(
                    f"drives.options: host_id {host} makes replies come on {reply:#x}, a drive's own "
                    "identifier or none; allowed: one that keeps them apart"
                )
        span = 2.0 * ranges.torque / 0xFFF
        self._top = TOP_COMMAND * span - ranges.torque

    @property
    def torque_limit(self) -> float:
        """N m of the top code that is sent."""
        return self._top

    @property
    def watchdog_danger(self) -> str:
        """Damiao alone has one that can be set."""
        return "" if self.damiao else unwatched(self.name)

    def fault_text(self, code: int) -> str:
        """Return what a code of the column `drive_fault` means."""
        return self.variant.faults.get(code - OWN_CODE, "")

    def resolution(self, _rate_Hz: float) -> Resolution:
        """Return a step of each field."""
        return resolution(self.ranges, 12, self.transmission)

    def reported_lengths(self) -> tuple[Array, Array] | None:
        """Return the leg lengths at the ends of the position's range."""
        return self.transmission.lengths_within(self.ranges.position / TURN)

    def coded(self, torque: Array) -> Array:
        """Return what the codes of 12 bits, which are truncated, leave of torques (6,) N m."""
        frames = (pack_command(0.0, 0.0, 0.0, 0.0, each, self.ranges) for each in torque.tolist())
        return np.array([unpack_command(frame, self.ranges)[4] for frame in frames])

    # controller's end

    def exchanges(self, setup: DriveSetup) -> tuple[tuple[Exchange, ...], ...]:
        """Return Damiao's registers; the others have none. Raises ProtocolError for too short a watchdog."""
        if not self.damiao:
            return ((),) * LEGS
        ticks = round(setup.watchdog_s * TICKS_PER_S)
        if ticks < 1:
            raise ProtocolError(f"drive watchdog of {setup.watchdog_s} s: Damiao counts it in 50 us")
        r = self.ranges
        return tuple(
            (
                _exchange(node, "CTRL_MODE (register 10)", WRITE, CTRL_MODE, 1),
                _exchange(node, "TIMEOUT (register 9)", WRITE, TIMEOUT, ticks),
                _exchange(node, "PMAX (register 21)", READ, PMAX, r.position),
                _exchange(node, "VMAX (register 22)", READ, VMAX, r.velocity),
                _exchange(node, "TMAX (register 23)", READ, TMAX, r.torque),
            )
            for node in self._nodes
        )

    def identity_requests(self) -> tuple[tuple[Frame, ...], ...]:
        """Return the readings of a Damiao's serial number and software version; the others have none."""
        if not self.damiao:
            return ()
        return tuple(
            tuple(_exchange(node, "", READ, register, 0.0).frames[0] for node in self._nodes)
            for register in _SAID
        )

    def identity(self, frame: Frame) -> Said | None:
        """Return what such a reading is answered with."""
        identifier, data, flags = frame
        if not self.damiao or flags & STRANGE or identifier not in self._replies or len(data) != 8:
            return None
        leg = self._replies.index(identifier)
        if data[:3] != bytes((self._nodes[leg], 0, READ)) or data[3] not in _SAID:
            return None
        return Said(leg, _SAID[data[3]], int.from_bytes(data[4:], "little"))

    def poll(self, dialogue: MotorDialogue, leg: int) -> Frame:
        """Return torque for an enabled drive, ENABLE for one that is to be, else DISABLE: a poll too."""
        node = self._nodes[leg]
        if dialogue.mode != DriveMode.RUN:
            clears = self.damiao and dialogue.mode == DriveMode.RESET and dialogue.power[leg] == _FAULT
            return Frame(node, CLEAR if clears else DISABLE)
        if not dialogue.ran[leg] and dialogue.power[leg] != _RUN:
            return Frame(node, ENABLE)
        return Frame(node, pack_command(0.0, 0.0, 0.0, 0.0, dialogue.torque[leg], self.ranges))

    def leg_addressed(self, frame: Frame) -> int | None:
        """Return the leg of a drive's identifier, or of the one that a register request names."""
        if frame.id != REGISTERS or not self.damiao:
            return self._legs.get(frame.id)
        return self._legs.get(frame.data[0] | frame.data[1] << 8) if len(frame.data) > 1 else None

    def hear(self, frame: Frame) -> Heard | None:
        """Return what a reply says: position turns, velocity turns/s, torque N m, status."""
        identifier, data, flags = frame
        if flags & STRANGE:
            return None
        if identifier in self._legs or (self.damiao and identifier == REGISTERS):
            return Heard(self._legs.get(identifier, 0), foreign=True)
        if identifier not in self._replies:
            return None
        first = self._replies.index(identifier)
        if len(data) not in self.variant.reply_bytes:
            return Heard(first, broken=True)
        if self.damiao:
            return self._hear_damiao(first, data)
        if data[0] not in self._legs:
            return Heard(first, broken=True)
        fault = data[7] if len(data) == 8 else 0
        return self._motion(self._legs[data[0]], data[1:6], _FAULT if fault else None, fault)

    def _hear_damiao(self, leg: int, data: bytes) -> Heard:
        node = self._nodes[leg]
        # A status is 0, 1 or above 7, so only a disabled drive near the lower end of its position could look
        # like a register's answer: it has the position code 0x0033 or 0x0055 there.
        if data[0] == node and data[1] == 0 and data[2] in (READ, WRITE):
            if data[3] not in _KIND or data[3] in _SAID:
                return Heard(leg)
            (value,) = struct.unpack(_KIND[data[3]], data[4:])
            return Heard(leg, answer=(data[3], float(value)))
        status = data[0] >> 4
        if data[0] & 0xF != node or (status > 1 and status not in self.variant.faults):
            return Heard(leg, broken=True)
        return self._motion(
            leg, data[1:6], (_OFF, _RUN)[status] if status < 2 else _FAULT, status * (status > 1)
        )

    def _motion(self, leg: int, data: bytes, power: DriveState | None, code: int) -> Heard:
        place, position, velocity, torque = unpack_motion(data, self.ranges)
        at_end = self.variant.clamps and place in (0, 0xFFFF)
        fault = OWN_CODE + code if code else 0
        if code and code == self.variant.silence:
            fault = int(DriveFault.WATCHDOG)
        motion = None if at_end else (position / TURN, velocity / TURN)
        return Heard(leg, motion=motion, feedback=True, torque=torque, power=power, fault=fault)

    def emergency_stop(self) -> tuple[Frame, ...]:
        """Return DISABLE for each drive: it does not latch."""
        return tuple(Frame(node, DISABLE) for node in self._nodes)

    # drives' end

    def parse(self, memory: MotorMemory, frame: Frame) -> tuple[MotorMemory, tuple[DeviceMessage, ...]]:
        """Decode at the drives' end. Every frame to a drive is answered by its feedback."""
        if frame.flags & STRANGE:
            return memory, ()
        if self.damiao and frame.id == REGISTERS:
            return self._on_register(memory, frame.data)
        leg = self._legs.get(frame.id)
        if leg is None:
            return memory, ()
        if len(frame.data) != 8:
            return memory, (Rejected(f"command of {len(frame.data)} bytes"),)
        modes: tuple[int, ...] = ()
        torque, after = 0.0, memory.enabled[leg]
        enables = frame.data == ENABLE and not after
        if frame.data == ZERO:
            return memory, (Rejected("the zero of the position is not emulated"), Sync(0, (leg,)))
        if frame.data == ENABLE:
            modes, after = (() if after else (DriveMode.READY, DriveMode.RUN)), True
        elif frame.data == DISABLE:
            modes, after = (DriveMode.OFF,), False
        elif frame.data == CLEAR and self.damiao:
            modes, after = (DriveMode.RESET,), False
        elif after:
            modes, torque = (DriveMode.RUN,), unpack_command(frame.data, self.ranges)[4]
        memory, commands = self._commanded(memory, leg, modes, torque)
        memory = memory._replace(enabled=put(memory.enabled, leg, after))
        first, last = self._delivered(memory, leg, enables, frame.data == DISABLE)
        return memory, (*first, *commands, *last, Sync(0, (leg,)))

    def _delivered(
        self, memory: MotorMemory, leg: int, enables: bool, disables: bool
    ) -> tuple[tuple[DeviceMessage, ...], tuple[DeviceMessage, ...]]:
        """Return what a drive is set to that no controller has set up, before and after the command."""
        held = Configure(leg, NO_WATCHDOG_S, Reaction.BRAKE)
        if self.damiao:
            ticks = dict(memory.registers[leg]).get(TIMEOUT, 0.0)
            return ((held._replace(watchdog_s=ticks / TICKS_PER_S) if ticks > 0.0 else held,) * enables), ()
        return (held,) * enables, (held,) * disables

    def _on_register(self, memory: MotorMemory, data: bytes) -> tuple[MotorMemory, tuple[DeviceMessage, ...]]:
        leg = self._legs.get(data[0] | data[1] << 8) if len(data) > 1 else None
        if len(data) == 8 and data[2] == REFRESH and leg is not None:
            return memory, (Sync(0, (leg,)),)
        if (
            len(data) != 8
            or data[2] not in (READ, WRITE)
            or data[3] not in _KIND
            or (data[2] == WRITE and data[3] in _SAID)
        ):
            return memory, (Rejected("register request"),)
        if leg is None:
            return memory, ()
        r, register = self.ranges, data[3]
        held = {CTRL_MODE: 0.0, TIMEOUT: 0.0, PMAX: r.position, VMAX: r.velocity, TMAX: r.torque}
        held |= {SN: float(self._nodes[leg]), SW_VER: 1.0}
        held |= dict(memory.registers[leg])
        messages: tuple[DeviceMessage, ...] = ()
        if data[2] == WRITE:
            (held[register],) = struct.unpack(_KIND[register], data[4:])
            if register == TIMEOUT and held[TIMEOUT] > 0:
                messages = (Configure(leg, held[TIMEOUT] / TICKS_PER_S, Reaction.BRAKE),)
            memory = memory._replace(registers=put(memory.registers, leg, tuple(held.items())))
        kind = _KIND[register]
        body = struct.pack(kind, int(held[register]) if kind == "<I" else held[register])
        reply = Frame(self._replies[leg], data[:4] + body)
        return memory, (*messages, Answer(leg, reply))

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
        """Encode what the drives of `sync.legs` answer; see `DriveProtocol.answer`.

        A lost encoder reads the lower end of the range: no field says so.
        """
        codes = np.zeros(LEGS, np.int64) if fault is None else fault
        turns, speeds, torques = self.motor(length, rate, force)
        frames = []
        for leg in sync.legs:
            said = int(state[leg])
            lost = bool(said & INVALID)
            self.finite(leg, turns[leg], speeds[leg], torques[leg])
            position = -self.ranges.position if lost else turns[leg] * TURN
            body = device_motion(
                position, speeds[leg] * TURN, torques[leg], self.ranges, clamps=self.variant.clamps
            )
            frames.append((leg, self._reply(leg, body, said & ~INVALID, int(codes[leg]))))
        return memory, frames

    def _reply(self, leg: int, body: bytes, state: int, fault: int) -> Frame:
        node, code = self._nodes[leg], 0
        if state == _FAULT:
            code = self._codes.get(DriveFault(fault), 0)
        if self.damiao:
            status = code or int(state == _RUN)
            return Frame(self._replies[leg], bytes((status << 4 | node, *body, 30, 30)))
        tail = bytes((30, code)) if self.variant.reply_bytes == (8,) else b"\x99"
        return Frame(self._replies[leg], bytes((node,)) + body + tail)

    # bus time

    def cyclic_frames(self) -> tuple[Frame, ...]:
        """Return one example of every frame of a tick: six commands, six feedbacks."""
        commands = (Frame(node, DISABLE) for node in self._nodes)
        return (*commands, *self.example_feedbacks())


_SAID = {SN: SERIAL, SW_VER: REVISION}
_KIND = {CTRL_MODE: "<I", TIMEOUT: "<I", SN: "<I", SW_VER: "<I", PMAX: "<f", VMAX: "<f", TMAX: "<f"}


def _exchange(node: int, name: str, kind: int, register: int, value: float) -> Exchange:
    asked = value if kind == WRITE else 0
    body = struct.pack(_KIND[register], int(asked) if _KIND[register] == "<I" else asked)
    data = bytes((node & 0xFF, node >> 8, kind, register)) + body
    return Exchange(name, register, (Frame(REGISTERS, data),), float(value))
