"""MIT framing on 11-bit identifiers: mini-cheetah, CubeMars and Damiao, both ends.

A command to a drive is its poll; it answers with position, velocity and torque. Gains are sent as zero: the
law is the controller's. Special frames are seven FF and FC enable, FD disable, FE zero (never sent), FB clear
the fault (Damiao). Damiao alone reports whether it is enabled, and has registers: control mode, the limit of
silence in units of 50 us, and the ranges, which are compared with the configured ones.
"""

import struct
from functools import cached_property

from drivers.config import BusSettings, DriveSettings
from drivers.errors import ConfigurationError, ProtocolError
from drivers.mit import kernels as k
from drivers.mit.family import MitFamily
from drivers.mit.fields import TOP_COMMAND, VARIANTS, pack_command
from drivers.motor_settings import unwatched
from drivers.motors import ANY, NO_BRAKE, Exchange
from drivers.protocol import (
    REVISION,
    SERIAL,
    DriveSetup,
    Frame,
    Said,
    Traits,
)

ENABLE, DISABLE, CLEAR, ZERO = (
    b"\xff" * 7 + bytes((last,)) for last in (k.ENABLE, k.DISABLE, k.CLEAR, k.ZERO)
)


class MitProtocol(MitFamily):
    """One variant's tables."""

    ear = k.hear
    number_at = 0, ANY

    def __init__(self, bus: BusSettings, drives: DriveSettings) -> None:
        """Take the sections. Raises ConfigurationError for what such drives do not have or cannot carry."""
        super().__init__(bus, drives, (6, 12))
        variant, host, end = self.variant, self.host, self.ranges.torque
        known, damiao = VARIANTS[variant], variant == "damiao"
        self.damiao = self.clears = damiao
        self.fault_names = known.faults
        self.refuse_nodes(1, 15 if damiao else 127, f"variant {variant}", ", as its reply names the node")
        self.replies = [node + host if damiao else host for node in self.nodes]
        for reply in self.replies:
            if not 0 <= reply < k.REGISTERS or reply in self.nodes:
                raise ConfigurationError(
                    f"drives.options: host_id {host} makes replies come on {reply:#x}, a drive's own "
                    "identifier or none; allowed: one that keeps them apart"
                )
        t = self.tables
        t["replies"], t["registers"], t["clamps"] = self.replies, damiao, known.clamps
        t["shortest"], t["longest"] = known.reply_bytes[0], known.reply_bytes[-1]
        t["faults"] = sum(1 << code for code in known.faults)
        t["requests"] = k.REGISTERS if damiao else -1
        t["silence"] = -1 if known.silence is None else known.silence
        self.torque_limit = TOP_COMMAND * (2.0 * end / 0xFFF) - end
        self.refuse_force(drives.force_limit_N)

    # controller's end

    @cached_property
    def traits(self) -> Traits:
        """Those of a variant: a Damiao alone says whether it is enabled and who it is; no stop latches."""
        size = VARIANTS[self.variant].reply_bytes[-1] - 1
        replies = zip(self.replies, self.nodes, strict=True)
        return self.traits_of(
            (Frame(reply, bytes((node, *bytes(size)))) for reply, node in replies),
            family="mit",
            emergency_stop=self.to_each(Frame(node, DISABLE) for node in self.nodes),
            identity_requests=tuple(
                self.to_each(_exchange(node, "", k.READ, register, 0.0).frames[0] for node in self.nodes)
                for register in (SAID if self.damiao else ())
            ),
            set_up_frames=int(self.damiao),
            has_watchdog=self.damiao,
            power_told="feedback" if self.damiao else "never",
            dangers=(NO_BRAKE,) if self.damiao else (NO_BRAKE, unwatched(self.variant)),
        )

    def exchanges(self, setup: DriveSetup) -> tuple[tuple[Exchange, ...], ...]:
        """Return Damiao's registers; the others have none. Raises ProtocolError for too short a watchdog."""
        if not self.damiao:
            return super().exchanges(setup)
        ticks = round(setup.watchdog_s * k.TICKS_PER_S)
        if ticks < 1:
            raise ProtocolError(f"drive watchdog of {setup.watchdog_s} s: Damiao counts it in 50 us")
        r = self.ranges
        return tuple(
            (
                _exchange(node, "CTRL_MODE (register 10)", k.WRITE, k.CTRL_MODE, 1),
                _exchange(node, "TIMEOUT (register 9)", k.WRITE, k.TIMEOUT, ticks),
                _exchange(node, "PMAX (register 21)", k.READ, k.PMAX, r.position),
                _exchange(node, "VMAX (register 22)", k.READ, k.VMAX, r.velocity),
                _exchange(node, "TMAX (register 23)", k.READ, k.TMAX, r.torque),
            )
            for node in self.nodes
        )

    def said_by(self, frame: Frame) -> Said | None:
        """Return what such a reading is answered with."""
        identifier, data, flags = frame
        if not self.damiao or flags & k.STRANGE or identifier not in self.replies or len(data) != 8:
            return None
        leg = self.replies.index(identifier)
        if data[:3] != bytes((self.nodes[leg], 0, k.READ)) or data[3] not in SAID:
            return None
        return Said(leg, SAID[data[3]], int.from_bytes(data[4:], "little"))

    def requests(self, _watchdog_s: float) -> tuple[tuple[Frame, ...], ...]:
        """Return DISABLE, what clears a fault, ENABLE, and torque: polls, all of them."""
        nothing = pack_command(0.0, 0.0, 0.0, 0.0, -self.ranges.torque, self.ranges)
        rows = DISABLE, CLEAR if self.damiao else DISABLE, ENABLE, nothing
        return tuple(tuple(Frame(node, data) for node in self.nodes) for data in rows)


SAID = {k.SN: SERIAL, k.SW_VER: REVISION}
KIND = {
    register: "<f" if register in (k.PMAX, k.VMAX, k.TMAX) else "<I"
    for register in (k.CTRL_MODE, k.TIMEOUT, k.PMAX, k.VMAX, k.TMAX, k.SN, k.SW_VER)
}
"""Format of a register."""


def _exchange(node: int, name: str, kind: int, register: int, value: float) -> Exchange:
    asked = value if kind == k.WRITE else 0
    body = struct.pack(KIND[register], int(asked) if KIND[register] == "<I" else asked)
    data = bytes((node & 0xFF, node >> 8, kind, register)) + body
    return Exchange(name, register, (Frame(k.REGISTERS, data),), float(value))
