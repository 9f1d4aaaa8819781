"""RobStride's own protocol on 29-bit identifiers: MIT's four numbers in 16 bits each, the torque in the id.

Identifier: type << 24 | data << 8 | target. Type 1 commands, data is the torque's code; 2 is the feedback,
data is mode << 14 | faults << 8 | motor; 3 enables; 4 stops, and clears faults if its first byte is 1; 17
reads and 18 writes a register; 0 asks for the processor's 64-bit number, which is answered to 0xFE or to the
host. Positions and torques are big-endian, registers and that number little-endian.
"""

import struct
from collections.abc import Sequence

import numpy as np

from drivers.arrays import Array
from drivers.codes import code, value
from drivers.errors import ConfigurationError
from drivers.identity import SERIAL, Said
from drivers.mit import robstride_kernels as kernels
from drivers.mit.fields import TURN, Ranges, resolution
from drivers.mit.robstride_kernels import (
    CONTROL,
    ENABLE,
    READ,
    STOP,
    WHO,
    WRITE,
)
from drivers.mit.variants import DRIVE_FAULT_CODES, ROBSTRIDE_FAULTS
from drivers.motor_drives import codes_of, put_written, written
from drivers.motor_kernels import EAR, IN_IDENTIFIER, OWN_CODE
from drivers.motor_settings import unwatched
from drivers.motors import Exchange, MotorProtocol
from drivers.protocol import (
    ALL_LEGS,
    EXTENDED,
    Answer,
    Configure,
    DeviceMessage,
    DriveSetup,
    Frame,
    Rejected,
    Sync,
)
from drivers.resolution import Resolution
from drivers.signals import LEGS, Reaction
from drivers.tick_columns import Record
from drivers.transmission import Transmission

ASKED_WHO = 0xFE
"""Whom the answer to the request for the processor's number is for."""
RUN_MODE = 0x7005
OPERATION = 0
"""Of RUN_MODE: MIT's five numbers."""
_ZEROS = bytes(8)


class RobStrideProtocol(MotorProtocol):
    """The tables of six drives."""

    ear, obey, encode = kernels.hear, kernels.obey, kernels.encode
    number_at = 0, 0xFF
    rejections = ("frame of {size} bytes",)
    clears = True
    set_up_frames = 2
    has_watchdog = False

    def __init__(
        self,
        ranges: Ranges,
        nodes: Sequence[int],
        host: int,
        transmission: Transmission,
        legs: Sequence[Sequence[int]] = (ALL_LEGS,),
    ) -> None:
        """Take the ranges, six motor numbers, the host's, and the legs of each bus.

        Raises ConfigurationError for other numbers.
        """
        tables = np.zeros((), EAR)
        super().__init__(transmission, tables, (IN_IDENTIFIER, 16, ranges.torque), legs)
        for leg, node in enumerate(nodes):
            if not 1 <= node <= 127:
                raise ConfigurationError(
                    f"drives.node_ids[{leg}]: out of range, allowed with variant robstride: 1 to 127, "
                    f"given: {node}"
                )
        if not 128 <= host <= 255:
            raise ConfigurationError(
                f"drives.options: host_id out of range, allowed: 128 to 255, given: {host}"
            )
        self.ranges, self._nodes, self._host = ranges, tuple(nodes), host
        self._legs = {node: leg for leg, node in enumerate(nodes)}
        tables["nodes"], tables["host"] = nodes, host
        tables["codes"] = codes_of(DRIVE_FAULT_CODES["robstride"], 4)
        tables["position"], tables["velocity"], tables["torque"] = (
            ranges.position,
            ranges.velocity,
            ranges.torque,
        )

    @property
    def torque_limit(self) -> float:
        """N m."""
        return self.ranges.torque

    @property
    def watchdog_danger(self) -> str:
        """It is set with the maker's tool."""
        return unwatched("robstride")

    def fault_text(self, code: int) -> str:
        """Return what the bits of a code of the column `drive_fault` mean."""
        bits = code - OWN_CODE
        return ", ".join(text for bit, text in ROBSTRIDE_FAULTS.items() if bits > 0 and bits & bit)

    def _to(self, kind: int, leg: int, data: bytes = _ZEROS, middle: int | None = None) -> Frame:
        middle = self._host if middle is None else middle
        return self.to_leg(leg, Frame(kind << 24 | middle << 8 | self._nodes[leg], data, EXTENDED))

    def resolution(self, _rate_Hz: float) -> Resolution:
        """Return a step of each field."""
        return resolution(self.ranges, 16, self.transmission)

    def reported_lengths(self) -> tuple[Array, Array] | None:
        """Return the leg lengths at the ends of the position's range."""
        return self.transmission.lengths_within(self.ranges.position / TURN)

    def coded(self, torque: Array) -> Array:
        """Return what the codes of 16 bits, which are truncated, leave of torques (6,) N m."""
        end = self.ranges.torque
        codes = (code(each, -end, end, 16) for each in torque.tolist())
        return np.array([value(each, -end, end, 16) for each in codes])

    # controller's end

    def identity_requests(self) -> tuple[tuple[Frame, ...], ...]:
        """Return the request for the processor's number of each drive."""
        return (tuple(self._to(WHO, leg) for leg in range(LEGS)),)

    def said_by(self, frame: Frame) -> Said | None:
        """Return that number."""
        identifier, data, flags = frame
        leg = self._legs.get(identifier >> 8 & 0xFFFF)
        answers = identifier >> 24 == WHO and identifier & 0xFF in (ASKED_WHO, self._host) and len(data) == 8
        if leg is None or not answers or not flags & EXTENDED or flags & kernels.STRANGE:
            return None
        return Said(leg, SERIAL, int.from_bytes(data, "little"))

    def exchanges(self, _setup: DriveSetup) -> tuple[tuple[Exchange, ...], ...]:
        """Return the writing and reading back of the run mode."""
        asked = struct.pack("<HxxI", RUN_MODE, OPERATION)
        read = struct.pack("<HxxI", RUN_MODE, 0)
        return tuple(
            (
                Exchange(
                    "run_mode (0x7005)",
                    RUN_MODE,
                    (self._to(WRITE, leg, asked), self._to(READ, leg, read)),
                    OPERATION,
                ),
            )
            for leg in range(LEGS)
        )

    def requests(self, _watchdog_s: float) -> tuple[tuple[Frame, ...], ...]:
        """Return STOP, the STOP that clears faults, ENABLE, and torque: polls, all of them."""
        r = self.ranges
        middle = struct.pack(
            ">HHHH", code(0.0, -r.position, r.position, 16), code(0.0, -r.velocity, r.velocity, 16), 0, 0
        )
        return (
            tuple(self._to(STOP, leg) for leg in range(LEGS)),
            tuple(self._to(STOP, leg, bytes((1, *bytes(7)))) for leg in range(LEGS)),
            tuple(self._to(ENABLE, leg) for leg in range(LEGS)),
            tuple(self._to(CONTROL, leg, middle, 0) for leg in range(LEGS)),
        )

    def emergency_stop(self) -> tuple[Frame, ...]:
        """Return STOP for each drive: it does not latch."""
        return tuple(self._to(STOP, leg) for leg in range(LEGS))

    # drives' end

    def converse(self, d: Record, leg: int | None, frame: Frame) -> tuple[DeviceMessage, ...]:
        """Take the request for the processor's number, or a register's; all but its reading has feedback."""
        identifier, data, _ = frame
        assert leg is not None
        kind = identifier >> 24
        if kind == WHO:
            said = self._nodes[leg].to_bytes(8, "little")
            return (Answer(leg, self._from(WHO, leg, said, ASKED_WHO)),)
        register, number = struct.unpack("<HxxI", data)
        if register != RUN_MODE:
            return (Rejected(f"register {register:#x}"),)
        if kind == WRITE:
            put_written(d, leg, {register: float(number)})
            return (Configure(leg, self.delivered_s, Reaction.BRAKE), Sync(0, (leg,)))
        # A drive leaves the factory in mode 0, and says so.
        said = struct.pack("<HxxI", register, int(written(d, leg).get(register, OPERATION)))
        return (Answer(leg, self._from(READ, leg, said, self._host)),)

    def _from(self, kind: int, leg: int, data: bytes, to: int) -> Frame:
        return self.to_leg(leg, Frame(kind << 24 | self._nodes[leg] << 8 | to, data, EXTENDED))

    # bus time

    def cyclic_frames(self) -> tuple[Frame, ...]:
        """Return one example of every frame of a tick: six commands, six feedbacks."""
        return (*self.emergency_stop(), *self.example_feedbacks())
