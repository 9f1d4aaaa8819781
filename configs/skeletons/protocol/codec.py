"""Controller's end of the protocol: commands of eight bytes, answers of six or seven."""

from functools import cached_property
from math import pi
from typing import Any

import numpy as np

from drivers import motor_kernels as motors
from drivers.config import BusSettings, DriveSettings
from drivers.frame_pointers import place_of, value
from drivers.motor_settings import Options, refuse_torque, unwatched
from drivers.motors import ANY, NO_BRAKE, MotorProtocol
from drivers.protocol import STRANGE, Frame, Resolution, Traits
from drivers.signals import LEGS

ANSWER_ID = 0
TURN = 2.0 * pi
ENABLE, DISABLE = b"\xff" * 7 + b"\xfc", b"\xff" * 7 + b"\xfd"
NOTHING = bytes.fromhex("7fff 7ff0 0000 0000")
"""Position and velocity in the middle of their ranges, gains 0, torque at the lower end of its field."""


@motors.hearing
def hear(ear: Any, frame: Any, heard: Any) -> int:
    """Read an answer (node, position, velocity, torque), or notice a command of another controller."""
    if frame.flags & STRANGE:
        return 0
    to = place_of(int(frame.id), ear.nodes)
    if to >= 0:
        return motors.says(heard, to, motors.FOREIGN)
    if frame.id != ANSWER_ID:
        return 0
    data, leg = frame.data, place_of(int(frame.data[0]), ear.nodes)
    if leg < 0 or not 6 <= frame.length <= 7:
        return motors.says(heard, max(leg, 0), motors.BROKEN)
    motors.says(heard, leg, motors.FEEDBACK | motors.MOTION | motors.TORQUE)
    position = int(data[1]) << 8 | int(data[2])
    velocity, torque = int(data[3]) << 4 | int(data[4]) >> 4, (int(data[4]) & 0xF) << 8 | int(data[5])
    heard.turns = value(position, -ear.position, ear.position, 16) / TURN
    heard.speed = value(velocity, -ear.velocity, ear.velocity, 12) / TURN
    heard.torque = value(torque, -ear.torque, ear.torque, 12)
    return 1


class CheetahProtocol(MotorProtocol):
    """Controller's end for six motors with equal ranges of position, velocity and torque."""

    ear = hear
    number_at = 0, ANY

    def __init__(self, bus: BusSettings, drives: DriveSettings) -> None:
        """Check sections `bus` and `drives`. Raises ConfigurationError for what these drives cannot do."""
        options = Options(bus, drives, "cheetah", "classic", ("position_rad", "velocity_rad_s", "torque_N_m"))
        torque = options.positive("torque_N_m", 18.0)
        super().__init__(options.transmission, drives.node_ids, (6, 12, torque), bus.legs)
        self.tables["position"] = options.positive("position_rad", 12.5)
        self.tables["velocity"], self.tables["torque"] = options.positive("velocity_rad_s", 65.0), torque
        # a torque of 0xFFC or 0xFFD could be taken for ENABLE or DISABLE
        self.torque_limit = 0xFFB * (2.0 * torque / 0xFFF) - torque
        self.refuse_nodes(1, 127, "cheetah")
        refuse_torque(self.transmission, drives.force_limit_N, self.torque_limit, "cheetah")

    def requests(self, _watchdog_s: float) -> tuple[tuple[Frame, ...], ...]:
        """Frames that idle a drive, clear its fault, enable it and set its torque."""
        rows = DISABLE, DISABLE, ENABLE, NOTHING
        return tuple(tuple(Frame(node, data) for node in self.nodes) for data in rows)

    @cached_property
    def traits(self) -> Traits:
        """Properties of these drives: they answer each command, and report neither power nor fault."""
        t, fields = self.transmission, (("position", 16), ("velocity", 12), ("torque", 12))
        steps = [2.0 * float(self.tables[name]) / ((1 << bits) - 1) for name, bits in fields]
        length, rate = (t.rate(np.full(LEGS, step / TURN)) for step in steps[:2])
        return self.traits_of(
            (Frame(ANSWER_ID, bytes((node, *bytes(5)))) for node in self.nodes),
            family="cheetah",
            resolution=Resolution.of(length, rate, t.N_per_Nm * steps[2]),
            reported_lengths=t.lengths_within(float(self.tables["position"]) / TURN),
            emergency_stop=self.to_each(Frame(node, DISABLE) for node in self.nodes),
            shares_identifiers=True,
            command_delay_ticks=1,
            has_watchdog=False,
            power_told="never",
            dangers=(NO_BRAKE, unwatched("cheetah")),
        )
