"""Codec of MIT framing on 11-bit identifiers: mini-cheetah, CubeMars and Damiao.

A command polls its drive, which answers with position, velocity and torque. Gains are sent as zero: the
control law runs in the controller. Special frames are seven FF and FC enable, FD disable, FE zero (never
sent), FB clear the fault (Damiao). Only a Damiao reports whether it is enabled, and has registers: control
mode, watchdog in units of 50 us, and the ranges, which are compared with the configured ones.
"""

import struct
from collections.abc import Iterable
from functools import cached_property
from typing import Any

import numpy as np

from drivers import motor_kernels as motors
from drivers.compiled.compiler import helper
from drivers.config import BusSettings, DriveSettings
from drivers.errors import ConfigurationError, ProtocolError
from drivers.frame_pointers import place_of, value, whole
from drivers.mit.fields import TOP_COMMAND, TURN, VARIANTS, Ranges
from drivers.motor_settings import Options, refuse_torque, unwatched
from drivers.motors import ANY, NO_BRAKE, Exchange, MotorProtocol
from drivers.protocol import BRS, FD, REVISION, SERIAL, STRANGE, DriveSetup, Frame, Resolution, Said, Traits
from drivers.signals import LEGS

REGISTERS = 0x7FF
"""Identifier of Damiao's requests."""
READ, WRITE, REFRESH = 0x33, 0x55, 0xCC
TIMEOUT, CTRL_MODE, SW_VER, SN, PMAX, VMAX, TMAX = 9, 10, 14, 15, 21, 22, 23
ENABLE, DISABLE, CLEAR, ZERO = (b"\xff" * 7 + bytes((last,)) for last in (0xFC, 0xFD, 0xFB, 0xFE))
NOTHING = bytes.fromhex("7fff7ff000000000")
"""Position and velocity in the middle of their ranges, no gains, torque code 0."""
TICKS_PER_S = 20_000
"""Units of Damiao's TIMEOUT per second."""


@helper
def _answer(data: Any, leg: int, heard: Any) -> int:
    register = int(data[3])
    is_single = register in (PMAX, VMAX, TMAX)
    if not is_single and register not in (CTRL_MODE, TIMEOUT):
        return motors.says(heard, leg, 0)
    motors.says(heard, leg, motors.ANSWER)
    heard.register = register
    heard.value = motors.single(data, 4) if is_single else float(whole(data, 4))
    return 1


@helper
def take_motion(ear: Any, leg: int, position: int, velocity: int, torque: int, bits: int, heard: Any) -> int:
    """Decode codes to turns, turns/s, N m; a position code at the end of a saturating field is no reading."""
    at_end = ear.clamps and position in (0, 0xFFFF)
    motors.says(heard, leg, motors.FEEDBACK | motors.TORQUE | (0 if at_end else motors.MOTION))
    if not at_end:
        heard.turns = value(position, -ear.position, ear.position, 16) / TURN
        heard.speed = value(velocity, -ear.velocity, ear.velocity, bits) / TURN
    heard.torque = value(torque, -ear.torque, ear.torque, bits)
    return 1


@motors.hearing
def hear(ear: Any, frame: Any, heard: Any) -> int:
    """Decode a reply into `heard`: position turns, velocity turns/s, torque N m, power state. 0: not one."""
    identifier, size, data = int(frame.id), int(frame.length), frame.data
    if frame.flags & STRANGE & ~ear.flags:
        return 0
    to = place_of(identifier, ear.nodes)
    if to >= 0 or (ear.registers and identifier == REGISTERS):
        return motors.says(heard, max(to, 0), motors.FOREIGN)
    first = place_of(identifier, ear.replies)
    if first < 0:
        return 0
    if not ear.shortest <= size <= ear.longest:
        return motors.says(heard, first, motors.BROKEN)
    head, p, v, t = int(data[0]), int(data[1]) << 8 | int(data[2]), int(data[3]) << 4, int(data[5])
    v, t = v | int(data[4]) >> 4, t | (int(data[4]) & 0xF) << 8
    leg = place_of(head & 0xF if ear.registers else head, ear.nodes)
    if leg < 0 or ear.replies[leg] != identifier:
        return motors.says(heard, first, motors.BROKEN)
    if not ear.registers:
        fault = int(data[7]) if size == 8 else 0
        take_motion(ear, leg, p, v, t, 12, heard)
        return motors.powers(ear, heard, fault, False) if fault else 1
    # A status is 0, 1 or above 7, so only a disabled drive near the lower end of its position could look
    # like a register's answer: it has the position code 0x0033 or 0x0055 there.
    if head == ear.nodes[leg] and data[1] == 0 and data[2] in (READ, WRITE):
        return _answer(data, leg, heard)
    status = head >> 4
    if status > 1 and not ear.faults >> status & 1:
        return motors.says(heard, leg, motors.BROKEN)
    take_motion(ear, leg, p, v, t, 12, heard)
    return motors.powers(ear, heard, status if status > 1 else 0, status == 1)


_HOSTS = {"mini_cheetah": (0,), "cubemars": (0,), "damiao": (16,), "robstride": (253, 128, 255)}
"""Identifier of the replies; Damiao: offset added to a drive's own number, or 0 for replies that all have
identifier 0, as delivered; RobStride: the controller's number, and its range."""
_FIELDS = {"position_rad": "position", "velocity_rad_s": "velocity", "torque_N_m": "torque"}


class MitFamily(MotorProtocol):
    """Base of codecs with MIT's fields: six drives with equal ranges of position, velocity and torque."""

    def __init__(self, bus: BusSettings, drives: DriveSettings, torque_field: tuple[int, int]) -> None:
        """Read the sections; torque_field: (first byte, bits) of the torque in a command.

        Raises ConfigurationError for settings that the variant does not support.
        """
        layout = "fd" if (drives.options.get("variant"), bus.layout) == ("damiao", "fd") else "classic"
        options = Options(bus, drives, "mit", layout, ("variant", "model", "host_id", *_FIELDS))
        self.variant = options.choice("variant", tuple(VARIANTS))
        models = VARIANTS[self.variant].models
        ranges: Ranges = models[options.choice("model", tuple(models))]
        given = {field: options.positive(key, getattr(ranges, field)) for key, field in _FIELDS.items()}
        self.ranges = ranges = ranges._replace(**given)
        self.host = options.whole("host_id", *_HOSTS[self.variant])
        self.flags = FD | BRS if layout == "fd" else 0
        super().__init__(options.transmission, drives.node_ids, (*torque_field, ranges.torque), bus.legs)
        for name in ("position", "velocity", "torque"):
            self.tables[name] = getattr(ranges, name)
        self.tables["clamps"], self.tables["flags"] = VARIANTS[self.variant].clamps, self.flags

    def traits_of(self, feedbacks: Iterable[Frame], **own: Any) -> Traits:
        """Properties of the drives; both ends truncate position, velocity and torque to their steps."""
        r, (_, bits, _), t = self.ranges, self.torque_field, self.transmission
        fields = (r.position, 16), (r.velocity, bits), (r.torque, bits)
        position, velocity, torque = (2.0 * end / ((1 << n) - 1) for end, n in fields)
        length, rate = (t.rate(np.full(LEGS, step / TURN)) for step in (position, velocity))
        return super().traits_of(
            feedbacks,
            resolution=Resolution.of(length, rate, t.N_per_Nm * torque),
            reported_lengths=t.lengths_within(r.position / TURN),
            shares_identifiers=True,
            command_delay_ticks=1,
            **own,
        )

    def refuse_force(self, force_N: float) -> None:
        """Raise ConfigurationError if the rated force, N, needs more torque than a command carries."""
        refuse_torque(self.transmission, force_N, self.torque_limit, f"mit, variant {self.variant},")


class MitProtocol(MitFamily):
    """Codec of a mini-cheetah, CubeMars or Damiao drive, as `drives.options` selects."""

    ear = hear
    number_at = 0, ANY

    def __init__(self, bus: BusSettings, drives: DriveSettings) -> None:
        super().__init__(bus, drives, (6, 12))
        variant, host, end = self.variant, self.host, self.ranges.torque
        known, damiao = VARIANTS[variant], variant == "damiao"
        self.damiao = self.clears = damiao
        self.fault_names = known.faults
        self.refuse_nodes(1, 15 if damiao else 127, f"variant {variant}", ", as a reply has the number")
        self.replies = [node + host if damiao and host else host for node in self.nodes]
        for reply in self.replies:
            if not 0 <= reply < REGISTERS or reply in self.nodes:
                raise ConfigurationError(
                    f"drives.options: with host_id {host} a reply has the identifier {reply:#x}, which is a "
                    "drive's own or invalid; choose another host_id"
                )
        t = self.tables
        t["replies"], t["registers"] = self.replies, damiao
        t["shortest"], t["longest"] = known.reply_bytes[0], known.reply_bytes[-1]
        t["faults"] = sum(1 << code for code in known.faults)
        t["requests"] = REGISTERS if damiao else -1
        t["silence"] = -1 if known.silence is None else known.silence
        self.torque_limit = TOP_COMMAND * (2.0 * end / 0xFFF) - end
        self.refuse_force(drives.force_limit_N)

    # controller's end

    @cached_property
    def traits(self) -> Traits:
        """Properties of the variant: only a Damiao reports power state and identity; no stop latches."""
        size = VARIANTS[self.variant].reply_bytes[-1] - 1
        replies = zip(self.replies, self.nodes, strict=True)
        return self.traits_of(
            (Frame(reply, bytes((node, *bytes(size))), self.flags) for reply, node in replies),
            family="mit",
            emergency_stop=self.to_each(Frame(node, DISABLE, self.flags) for node in self.nodes),
            identity_requests=tuple(
                self.to_each(self._exchange(node, "", READ, register, 0.0).frames[0] for node in self.nodes)
                for register in (SAID if self.damiao else ())
            ),
            set_up_frames=int(self.damiao),
            has_watchdog=self.damiao,
            power_told="feedback" if self.damiao else "never",
            dangers=(NO_BRAKE,) if self.damiao else (NO_BRAKE, unwatched(self.variant)),
        )

    def exchanges(self, setup: DriveSetup) -> tuple[tuple[Exchange, ...], ...]:
        """Start-up exchanges with each Damiao's registers. Raises ProtocolError for a short watchdog."""
        if not self.damiao:
            return super().exchanges(setup)
        ticks = round(setup.watchdog_s * TICKS_PER_S)
        if ticks < 1:
            raise ProtocolError(
                f"drives.watchdog_ms: {1e3 * setup.watchdog_s:g} ms is too short, allowed: at least 0.05"
            )
        r = self.ranges
        return tuple(
            (
                self._exchange(node, "CTRL_MODE (register 10)", WRITE, CTRL_MODE, 1),
                self._exchange(node, "TIMEOUT (register 9)", WRITE, TIMEOUT, ticks),
                self._exchange(node, "PMAX (register 21)", READ, PMAX, r.position),
                self._exchange(node, "VMAX (register 22)", READ, VMAX, r.velocity),
                self._exchange(node, "TMAX (register 23)", READ, TMAX, r.torque),
            )
            for node in self.nodes
        )

    def said_by(self, frame: Frame) -> Said | None:
        """Serial or revision number in the answer to a read of its register; None for any other frame."""
        identifier, data, flags = frame
        if not self.damiao or flags & STRANGE & ~self.flags or len(data) != 8:
            return None
        leg = self.legs_of.get(data[0])
        if (
            leg is None
            or self.replies[leg] != identifier
            or data[1:3] != bytes((0, READ))
            or data[3] not in SAID
        ):
            return None
        return Said(leg, SAID[data[3]], int.from_bytes(data[4:], "little"))

    def requests(self, _watchdog_s: float) -> tuple[tuple[Frame, ...], ...]:
        """Frames by purpose: DISABLE, clear a fault, ENABLE, torque. Drives answer each: all are polls."""
        rows = DISABLE, CLEAR if self.damiao else DISABLE, ENABLE, NOTHING
        return tuple(tuple(Frame(node, data, self.flags) for node in self.nodes) for data in rows)

    def _exchange(self, node: int, name: str, kind: int, register: int, value: float) -> Exchange:
        asked = value if kind == WRITE else 0
        body = struct.pack(KIND[register], int(asked) if KIND[register] == "<I" else asked)
        data = bytes((node & 0xFF, node >> 8, kind, register)) + body
        return Exchange(name, register, (Frame(REGISTERS, data, self.flags),), float(value))


SAID = {SN: SERIAL, SW_VER: REVISION}
KIND = {
    register: "<f" if register in (PMAX, VMAX, TMAX) else "<I"
    for register in (CTRL_MODE, TIMEOUT, PMAX, VMAX, TMAX, SN, SW_VER)
}
"""Format of a register."""
