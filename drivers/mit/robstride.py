"""RobStride's own protocol on 29-bit identifiers: MIT's four numbers in 16 bits each, the torque in the id.

Identifier: type << 24 | data << 8 | target. Type 1 commands, data is the torque's code; 2 is the feedback,
data is mode << 14 | faults << 8 | motor; 3 enables; 4 stops, and clears faults if its first byte is 1; 17
reads and 18 writes a register; the answer to a read has data status << 8 | motor, and a status that is not 0
is a refusal; 0 requests the processor's 64-bit number, which is sent to 0xFE or to the host. Positions and
torques are big-endian, registers and the processor's number little-endian.
"""

import struct
from functools import cached_property
from typing import Any

import numpy as np

from drivers import motor_kernels as motors
from drivers.config import BusSettings, DriveSettings
from drivers.frame_pointers import code, place_of, whole
from drivers.mit.fields import ROBSTRIDE_FAULTS
from drivers.mit.protocol import MitFamily, take_motion
from drivers.motor_kernels import IN_IDENTIFIER
from drivers.motor_settings import unwatched
from drivers.motors import NO_BRAKE, Exchange
from drivers.protocol import ERROR, EXTENDED, FD, REMOTE, SERIAL, DriveSetup, Frame, Said, Traits

WHO, CONTROL, FEEDBACK, ENABLE, STOP, READ, WRITE = 0, 1, 2, 3, 4, 17, 18
RESETTING, CALIBRATING, RUNNING = range(3)
"""Modes in a feedback."""
STRANGE = FD | REMOTE | ERROR


@motors.hearing
def hear(ear: Any, frame: Any, heard: Any) -> int:
    """Decode a feedback or a register's answer into `heard` (HEARD record); 0: neither."""
    if not frame.flags & EXTENDED or frame.flags & STRANGE:
        return 0
    identifier = int(frame.id)
    kind, middle, target = identifier >> 24, identifier >> 8 & 0xFFFF, identifier & 0xFF
    to = place_of(target, ear.nodes)
    if to >= 0 and kind in (CONTROL, ENABLE, STOP, READ, WRITE):
        return motors.says(heard, to, motors.FOREIGN)
    leg = place_of(middle & 0xFF, ear.nodes)
    if target != ear.host or leg < 0 or kind not in (FEEDBACK, READ):
        return 0
    if frame.length != 8:
        return motors.says(heard, leg, motors.BROKEN)
    data = frame.data
    if kind == READ:
        refused = middle >> 8 != 0
        motors.says(heard, leg, motors.BROKEN if refused else motors.ANSWER)
        heard.register, heard.value = whole(data, 0, 2), np.nan if refused else float(data[4])
        return 1
    p, v = int(data[0]) << 8 | int(data[1]), int(data[2]) << 8 | int(data[3])
    take_motion(ear, leg, p, v, int(data[4]) << 8 | int(data[5]), 16, heard)
    return motors.powers(ear, heard, middle >> 8 & 0x3F, middle >> 14 == RUNNING)


ASKED_WHO = 0xFE
"""Target of the answer to the request for the processor's number."""
RUN_MODE = 0x7005
OPERATION = 0
"""Value of RUN_MODE for MIT's five numbers: the factory setting, which a drive reports."""
_ZEROS = bytes(8)


class RobStrideProtocol(MitFamily):
    """Codec of six RobStride drives."""

    ear = hear
    number_at = 0, 0xFF
    clears = True
    fault_names, fault_bits = ROBSTRIDE_FAULTS, True

    def __init__(self, bus: BusSettings, drives: DriveSettings) -> None:
        super().__init__(bus, drives, (IN_IDENTIFIER, 16))
        self.torque_limit = self.ranges.torque
        self.refuse_nodes(1, 127, "variant robstride")
        self.tables["host"] = self.host
        self.refuse_force(drives.force_limit_N)

    def _to_each(self, kind: int, data: bytes = _ZEROS, middle: int | None = None) -> tuple[Frame, ...]:
        first = kind << 24 | (self.host if middle is None else middle) << 8
        return self.to_each(Frame(first | node, data, EXTENDED) for node in self.nodes)

    # controller's end

    @cached_property
    def traits(self) -> Traits:
        """Properties of RobStride drives: they answer each command; a stop does not latch."""
        answers = (FEEDBACK << 24 | RUNNING << 22 | node << 8 | self.host for node in self.nodes)
        return self.traits_of(
            (Frame(each, _ZEROS, EXTENDED) for each in answers),
            family="robstride",
            emergency_stop=self._to_each(STOP),
            identity_requests=(self._to_each(WHO),),
            set_up_frames=2,
            has_watchdog=False,
            dangers=(NO_BRAKE, unwatched("robstride")),
        )

    def said_by(self, frame: Frame) -> Said | None:
        """Serial number of a drive: its processor's 64-bit number; None for any other frame."""
        identifier, data, flags = frame
        leg = self.legs_of.get(identifier >> 8 & 0xFFFF)
        answers = identifier >> 24 == WHO and identifier & 0xFF in (ASKED_WHO, self.host) and len(data) == 8
        if leg is None or not answers or not flags & EXTENDED or flags & STRANGE:
            return None
        return Said(leg, SERIAL, int.from_bytes(data, "little"))

    def exchanges(self, _setup: DriveSetup) -> tuple[tuple[Exchange, ...], ...]:
        """Start-up exchange of each drive: write the run mode and read it back."""
        writes = self._to_each(WRITE, struct.pack("<HxxI", RUN_MODE, OPERATION))
        reads = self._to_each(READ, struct.pack("<HxxI", RUN_MODE, 0))
        frames = zip(writes, reads, strict=True)
        return tuple((Exchange("run_mode (0x7005)", RUN_MODE, both, OPERATION),) for both in frames)

    def requests(self, _watchdog_s: float) -> tuple[tuple[Frame, ...], ...]:
        """Frames by purpose: STOP, STOP that clears faults, ENABLE, torque. Drives answer each frame."""
        zeros = [code(0.0, -end, end, 16) for end in (self.ranges.position, self.ranges.velocity)]
        torque = struct.pack(">HHHH", *zeros, 0, 0)
        clear = bytes((1, *bytes(7)))
        asked = (STOP, _ZEROS), (STOP, clear), (ENABLE, _ZEROS), (CONTROL, torque, 0)
        return tuple(self._to_each(*each) for each in asked)
