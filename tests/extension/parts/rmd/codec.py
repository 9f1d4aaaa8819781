"""MyActuator RMD V3 motors: one status request and one torque per tick.

Angles in whole degrees of the output.
"""

from functools import cached_property
from typing import Any

import numpy as np
from drivers import motor_kernels as motors
from drivers.config import BusSettings, DriveSettings
from drivers.frame_pointers import place_of, signed, whole
from drivers.motor_kernels import PREPARES, SIGNED
from drivers.motor_settings import Options, refuse_torque, unwatched
from drivers.motors import ANY, NO_BRAKE, MotorProtocol, push
from drivers.protocol import STRANGE, Frame, Resolution, Traits

REQUEST_ID, ANSWER_ID = 0x140, 0x240
SHUTDOWN, RELEASE_BRAKE, STATUS, TORQUE = 0x80, 0x77, 0x9C, 0xA1
CURRENT_A, DEGREE = 0.01, 1.0 / 360.0


@motors.hearing
def hear(ear: Any, frame: Any, heard: Any) -> int:
    """Read a request of another controller, or an answer; the one to STATUS has current, speed and angle."""
    if frame.flags & STRANGE:
        return 0
    to, leg, data = place_of(int(frame.id), ear.nodes), place_of(int(frame.id), ear.replies), frame.data
    if to >= 0:
        return motors.says(heard, to, motors.FOREIGN)
    if leg < 0:
        return 0
    if frame.length != 8:
        return motors.says(heard, leg, motors.BROKEN)
    if data[0] != STATUS:
        return motors.says(heard, leg, 0)
    motors.says(heard, leg, motors.FEEDBACK | motors.MOTION | motors.TORQUE)
    heard.torque = signed(whole(data, 2, 2), 16) * ear.torque / 32768.0
    heard.speed = signed(whole(data, 4, 2), 16) * DEGREE
    heard.turns = signed(whole(data, 6, 2), 16) * DEGREE
    return 1


class RmdProtocol(MotorProtocol):
    """Six motors with the same torque constant."""

    ear, commanding, rule = hear, push, PREPARES
    number_at = 0, ANY

    def __init__(self, bus: BusSettings, drives: DriveSettings) -> None:
        options = Options(bus, drives, "rmd", "classic", ("torque_N_m_A",))
        end = 32768 * CURRENT_A * options.positive("torque_N_m_A", 1.0)
        requests, answers = ([first + node for node in drives.node_ids] for first in (REQUEST_ID, ANSWER_ID))
        super().__init__(options.transmission, requests, (4, SIGNED, end), bus.legs, answers)
        self.tables["replies"], self.tables["torque"] = answers, end
        self.torque_limit = end * 32767 / 32768
        refuse_torque(self.transmission, drives.force_limit_N, self.torque_limit, "rmd")
        self.polls = self._each(STATUS)

    def _each(self, command: int) -> tuple[Frame, ...]:
        return self.to_each(Frame(node, bytes((command, *bytes(7)))) for node in self.nodes)

    def requests(self, _watchdog_s: float) -> tuple[tuple[Frame, ...], ...]:
        """Frames that shut a drive down, reset it, release its brake, set its torque, and prepare it."""
        return tuple(map(self._each, (SHUTDOWN, SHUTDOWN, RELEASE_BRAKE, TORQUE, SHUTDOWN)))

    @cached_property
    def traits(self) -> Traits:
        t = self.transmission
        length, torque = t.rate(np.full(6, DEGREE)), t.N_per_Nm * self.tables["torque"] / 32768
        return self.traits_of(
            (Frame(answer, bytes((STATUS, *bytes(7)))) for answer in self.wanted),
            family="rmd",
            resolution=Resolution.of(length, length, torque),
            reported_lengths=t.lengths_within(32767 * DEGREE),
            emergency_stop=self._each(SHUTDOWN),
            has_watchdog=False,
            power_told="never",
            dangers=(NO_BRAKE, unwatched("rmd")),
        )
