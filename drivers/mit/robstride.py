"""RobStride's own protocol on 29-bit identifiers: MIT's four numbers in 16 bits each, the torque in the id.

Identifier: type << 24 | data << 8 | target. Type 1 commands, data is the torque's code; 2 is the feedback,
data is mode << 14 | faults << 8 | motor; 3 enables; 4 stops, and clears faults if its first byte is 1; 17
reads and 18 writes a register; 0 asks for the processor's 64-bit number, which is answered to 0xFE or to the
host. Positions and torques are big-endian, registers and that number little-endian.
"""

import struct
from functools import cached_property

from drivers.config import BusSettings, DriveSettings
from drivers.errors import ConfigurationError
from drivers.frame_pointers import code
from drivers.mit import robstride_kernels as k
from drivers.mit.family import MitFamily
from drivers.mit.fields import ROBSTRIDE_FAULTS
from drivers.motor_kernels import IN_IDENTIFIER
from drivers.motor_settings import unwatched
from drivers.motors import NO_BRAKE, Exchange
from drivers.protocol import (
    EXTENDED,
    SERIAL,
    DriveSetup,
    Frame,
    Said,
    Traits,
)

ASKED_WHO = 0xFE
"""Whom the answer to the request for the processor's number is for."""
RUN_MODE = 0x7005
OPERATION = 0
"""Of RUN_MODE: MIT's five numbers. A drive leaves the factory in it, and says so."""
_ZEROS = bytes(8)


class RobStrideProtocol(MitFamily):
    """The tables of six drives."""

    ear = k.hear
    number_at = 0, 0xFF
    clears = True
    fault_names, fault_bits = ROBSTRIDE_FAULTS, True

    def __init__(self, bus: BusSettings, drives: DriveSettings) -> None:
        """Take the sections. Raises ConfigurationError for what such drives do not have or cannot carry."""
        super().__init__(bus, drives, (IN_IDENTIFIER, 16))
        host, self.torque_limit = self.host, self.ranges.torque
        self.refuse_nodes(1, 127, "variant robstride")
        if not 128 <= host <= 255:
            raise ConfigurationError(
                f"drives.options: host_id out of range, allowed: 128 to 255, given: {host}"
            )
        self.tables["host"] = host
        self.refuse_force(drives.force_limit_N)

    def _to_each(self, kind: int, data: bytes = _ZEROS, middle: int | None = None) -> tuple[Frame, ...]:
        first = kind << 24 | (self.host if middle is None else middle) << 8
        return self.to_each(Frame(first | node, data, EXTENDED) for node in self.nodes)

    # controller's end

    @cached_property
    def traits(self) -> Traits:
        """Those of drives that answer each command; a stop does not latch."""
        answers = (k.FEEDBACK << 24 | k.RUNNING << 22 | node << 8 | self.host for node in self.nodes)
        return self.traits_of(
            (Frame(each, _ZEROS, EXTENDED) for each in answers),
            family="robstride",
            emergency_stop=self._to_each(k.STOP),
            identity_requests=(self._to_each(k.WHO),),
            set_up_frames=2,
            has_watchdog=False,
            dangers=(NO_BRAKE, unwatched("robstride")),
        )

    def said_by(self, frame: Frame) -> Said | None:
        """Return that number."""
        identifier, data, flags = frame
        leg = self.legs_of.get(identifier >> 8 & 0xFFFF)
        answers = identifier >> 24 == k.WHO and identifier & 0xFF in (ASKED_WHO, self.host) and len(data) == 8
        if leg is None or not answers or not flags & EXTENDED or flags & k.STRANGE:
            return None
        return Said(leg, SERIAL, int.from_bytes(data, "little"))

    def exchanges(self, _setup: DriveSetup) -> tuple[tuple[Exchange, ...], ...]:
        """Return the writing and reading back of the run mode."""
        writes = self._to_each(k.WRITE, struct.pack("<HxxI", RUN_MODE, OPERATION))
        reads = self._to_each(k.READ, struct.pack("<HxxI", RUN_MODE, 0))
        frames = zip(writes, reads, strict=True)
        return tuple((Exchange("run_mode (0x7005)", RUN_MODE, both, OPERATION),) for both in frames)

    def requests(self, _watchdog_s: float) -> tuple[tuple[Frame, ...], ...]:
        """Return STOP, the STOP that clears faults, ENABLE, and torque: polls, all of them."""
        zeros = [code(0.0, -end, end, 16) for end in (self.ranges.position, self.ranges.velocity)]
        torque = struct.pack(">HHHH", *zeros, 0, 0)
        clear = bytes((1, *bytes(7)))
        asked = (k.STOP, _ZEROS), (k.STOP, clear), (k.ENABLE, _ZEROS), (k.CONTROL, torque, 0)
        return tuple(self._to_each(*each) for each in asked)
