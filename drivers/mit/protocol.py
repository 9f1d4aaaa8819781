"""MIT framing on 11-bit identifiers: mini-cheetah, CubeMars and Damiao, both ends.

A command to a drive is its poll; it answers with position, velocity and torque. Gains are sent as zero: the
law is the controller's. Special frames are seven FF and FC enable, FD disable, FE zero (never sent), FB clear
the fault (Damiao). Damiao alone reports whether it is enabled, and has registers: control mode, the limit of
silence in units of 50 us, and the ranges, which are compared with the configured ones.
"""

import struct
from collections.abc import Sequence

import numpy as np

from drivers.arrays import Array
from drivers.errors import ConfigurationError, ProtocolError
from drivers.identity import REVISION, SERIAL, Said
from drivers.mit import kernels
from drivers.mit.fields import (
    TOP_COMMAND,
    TURN,
    Ranges,
    pack_command,
    resolution,
    unpack_command,
)
from drivers.mit.kernels import (
    CTRL_MODE,
    PMAX,
    READ,
    REFRESH,
    REGISTERS,
    SN,
    SW_VER,
    TICKS_PER_S,
    TIMEOUT,
    TMAX,
    VMAX,
    WRITE,
)
from drivers.mit.variants import DRIVE_FAULT_CODES, VARIANTS
from drivers.motor_device_kernels import ANY
from drivers.motor_drives import codes_of, put_written, written
from drivers.motor_kernels import EAR, OWN_CODE
from drivers.motor_settings import unwatched
from drivers.motors import Exchange, MotorProtocol
from drivers.protocol import (
    ALL_LEGS,
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

ENABLE, DISABLE, CLEAR, ZERO = (
    b"\xff" * 7 + bytes((last,)) for last in (kernels.ENABLE, kernels.DISABLE, kernels.CLEAR, kernels.ZERO)
)


class MitProtocol(MotorProtocol):
    """One variant's tables."""

    ear, obey, encode = kernels.hear, kernels.obey, kernels.encode
    number_at = 0, ANY
    rejections = "command of {size} bytes", "the zero of the position is not emulated"

    def __init__(
        self,
        variant: str,
        ranges: Ranges,
        nodes: Sequence[int],
        host: int,
        transmission: Transmission,
        legs: Sequence[Sequence[int]] = (ALL_LEGS,),
    ) -> None:
        """Take variant, ranges, six identifiers, the reply's (Damiao's less the node's), and legs by bus.

        Raises ConfigurationError for nodes that the frames cannot tell apart.
        """
        tables = np.zeros((), EAR)
        super().__init__(transmission, tables, (6, 12, ranges.torque), legs)
        self.name, self.variant, self.ranges = variant, VARIANTS[variant], ranges
        self.damiao = variant == "damiao"
        self.set_up_frames = 1 if self.damiao else 0
        self.clears = self.damiao
        self.reports_power = self.has_watchdog = self.damiao
        self.requests_id = REGISTERS if self.damiao else -1
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
        known = self.variant
        tables["nodes"], tables["replies"], tables["registers"] = nodes, self._replies, self.damiao
        tables["position"], tables["velocity"], tables["torque"] = (
            ranges.position,
            ranges.velocity,
            ranges.torque,
        )
        tables["shortest"], tables["longest"] = known.reply_bytes[0], known.reply_bytes[-1]
        tables["clamps"], tables["faults"] = known.clamps, sum(1 << code for code in known.faults)
        tables["codes"] = codes_of(DRIVE_FAULT_CODES.get(variant, {}), 0)
        tables["silence"] = -1 if known.silence is None else known.silence
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
            self._to_each(*(_exchange(node, "", READ, register, 0.0).frames[0] for node in self._nodes))
            for register in _SAID
        )

    def said_by(self, frame: Frame) -> Said | None:
        """Return what such a reading is answered with."""
        identifier, data, flags = frame
        if not self.damiao or flags & kernels.STRANGE or identifier not in self._replies or len(data) != 8:
            return None
        leg = self._replies.index(identifier)
        if data[:3] != bytes((self._nodes[leg], 0, READ)) or data[3] not in _SAID:
            return None
        return Said(leg, _SAID[data[3]], int.from_bytes(data[4:], "little"))

    def requests(self, _watchdog_s: float) -> tuple[tuple[Frame, ...], ...]:
        """Return DISABLE, what clears a fault, ENABLE, and torque: polls, all of them."""
        nothing = pack_command(0.0, 0.0, 0.0, 0.0, -self.ranges.torque, self.ranges)
        rows = DISABLE, CLEAR if self.damiao else DISABLE, ENABLE, nothing
        return tuple(tuple(Frame(node, data) for node in self._nodes) for data in rows)

    def emergency_stop(self) -> tuple[Frame, ...]:
        """Return DISABLE for each drive: it does not latch."""
        return self._to_each(*(Frame(node, DISABLE) for node in self._nodes))

    def _to_each(self, *frames: Frame) -> tuple[Frame, ...]:
        return tuple(self.to_leg(leg, frame) for leg, frame in enumerate(frames))

    # drives' end

    def converse(self, d: Record, leg: int | None, frame: Frame) -> tuple[DeviceMessage, ...]:
        """Take the request of a Damiao's register."""
        data = frame.data
        if frame.flags & kernels.STRANGE:
            return ()
        if len(data) == 8 and data[2] == REFRESH and leg is not None:
            return (Sync(0, (leg,)),)
        if (
            len(data) != 8
            or data[2] not in (READ, WRITE)
            or data[3] not in _KIND
            or (data[2] == WRITE and data[3] in _SAID)
        ):
            return (Rejected("register request"),)
        if leg is None:
            return ()
        r, register = self.ranges, data[3]
        held = {CTRL_MODE: 0.0, TIMEOUT: 0.0, PMAX: r.position, VMAX: r.velocity, TMAX: r.torque}
        held |= {SN: float(self._nodes[leg]), SW_VER: 1.0}
        held |= written(d, leg)
        messages: tuple[DeviceMessage, ...] = ()
        if data[2] == WRITE:
            (held[register],) = struct.unpack(_KIND[register], data[4:])
            if register == TIMEOUT and held[TIMEOUT] > 0:
                messages = (Configure(leg, held[TIMEOUT] / TICKS_PER_S, Reaction.BRAKE),)
            put_written(d, leg, held)
        kind = _KIND[register]
        body = struct.pack(kind, int(held[register]) if kind == "<I" else held[register])
        reply = self.to_leg(leg, Frame(self._replies[leg], data[:4] + body))
        return (*messages, Answer(leg, reply))

    # bus time

    def cyclic_frames(self) -> tuple[Frame, ...]:
        """Return one example of every frame of a tick: six commands, six feedbacks."""
        return (*self.emergency_stop(), *self.example_feedbacks())


_SAID = {SN: SERIAL, SW_VER: REVISION}
_KIND = {CTRL_MODE: "<I", TIMEOUT: "<I", SN: "<I", SW_VER: "<I", PMAX: "<f", VMAX: "<f", TMAX: "<f"}


def _exchange(node: int, name: str, kind: int, register: int, value: float) -> Exchange:
    asked = value if kind == WRITE else 0
    body = struct.pack(_KIND[register], int(asked) if _KIND[register] == "<I" else asked)
    data = bytes((node & 0xFF, node >> 8, kind, register)) + body
    return Exchange(name, register, (Frame(REGISTERS, data),), float(value))
