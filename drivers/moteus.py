"""moteus: registers over CAN FD, the query in the frame of the command, both ends.

Identifier: source << 8 | destination, bit 15 where a reply is wanted; extended where it is over 0x7FF, so
commands are, and replies of the ids from 8 on. What a frame holds is in `moteus_kernels`. Torque goes as
feed-forward of position mode without position and gains. Every such command carries the time after which the
drive gives up (mode 11, until a stop), and a stop clears faults: outside RUN the polls are stops. A drive
that restarts obeys the next command, and may answer it as enabled: then nobody sees the restart. One that
says that it is stopped is not commanded again until RUN is asked for anew. Source: the
reference of the moteus protocol (mjbots), and the package `moteus` 1.1.1.
"""

import struct
from functools import cached_property
from math import nan

import numpy as np

from drivers import moteus_kernels as kernels
from drivers.config import BusSettings, DriveSettings
from drivers.errors import ConfigurationError
from drivers.moteus_kernels import ALL_NODES, REPLY_WANTED
from drivers.motor_kernels import FALLS
from drivers.motor_settings import Options, refuse_torque
from drivers.motors import MotorProtocol
from drivers.protocol import BRS, EXTENDED, FD, REVISION, SERIAL, Frame, Said, Traits
from drivers.signals import Reaction

QUERY = bytes.fromhex("11001f01130d")
"""Read the mode as int8; position, velocity, torque as floats; voltage, temperature, fault as int8."""
WHO, WHICH = bytes.fromhex("1ba002"), bytes.fromhex("198102")
"""Read the serial number, the version of the firmware; each as int32."""
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
_WORD = 0xFFFFFFFF
_SERIAL = tuple(range(kernels.SERIAL_NUMBER, kernels.SERIAL_NUMBER + 3))
_MAX_TORQUE = 1e4
_BRAKES = (
    "drives.protocol: a moteus has no brake output, and its aux pins keep their level when it faults "
    "or its time is over, so none of them is used: a platform without power falls unless brakes of "
    "your own close by themselves when a drive is stopped; the brake tests test those"
)
_TIME_IS_OVER = (
    "drives.options: what a drive does when its time is over is its own servo.timeout_mode; set "
    "it to {} with moteus_tool, as nothing here reads it back"
)


def torque_command(torque: float, most: float, timeout_s: float) -> bytes:
    """Return a command of torque N m with its limit N m, its watchdog s and the query, not filled up."""
    values = struct.pack("<6f", nan, 0.0, torque, 0.0, 0.0, most)
    return b"\x01\0\x0a\x0c\x06\x20" + values + b"\x0d\x27" + struct.pack("<f", timeout_s) + QUERY


TORQUE_AT = 14
"""Of its bytes the first one of the torque."""
STOP = kernels.pad(b"\x01\0\0" + QUERY)
_ANSWER = kernels.pad(b"\x21\0\x0a\x2f\x01" + bytes(12) + b"\x23\x0d\0\0\0")
"""An answer to QUERY."""
_TIMEOUT_MODES = {"stopped": Reaction.BRAKE, "zero_velocity": Reaction.DAMP}


class MoteusProtocol(MotorProtocol):
    """The tables of six drives."""

    ear, rule = kernels.hear, FALLS
    number_at, delivered_s = (0, ALL_NODES), DEFAULT_TIMEOUT_S
    fault_names = FAULTS

    def __init__(self, bus: BusSettings, drives: DriveSettings) -> None:
        """Take the sections. Raises ConfigurationError for what such drives do not have or cannot carry."""
        options = Options(bus, drives, "moteus", "fd", ("host_id", "timeout_mode", "torque_N_m"))
        transmission, nodes = options.transmission, drives.node_ids
        self._reaction = _TIMEOUT_MODES[options.choice("timeout_mode", tuple(_TIMEOUT_MODES))]
        self.torque_limit = most = options.positive("torque_N_m", _MAX_TORQUE)
        name = f"moteus, by drives.options: torque_N_m {most:g},"
        refuse_torque(transmission, drives.force_limit_N, most, name)
        self.host = host = options.whole("host_id", 0)
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
        answers = tuple(node << 8 | host for node in nodes)
        super().__init__(transmission, nodes, (TORQUE_AT, 32, 0.0), bus.legs, answers)
        self.tables["replies"] = answers

    # controller's end

    @cached_property
    def traits(self) -> Traits:
        """Those of drives that answer commands at once; a stop does not latch."""
        does = "0, stopped" if self._reaction == Reaction.BRAKE else "12, zero velocity"
        return self.traits_of(
            (Frame(each, _ANSWER, FD | BRS | (EXTENDED if each > 0x7FF else 0)) for each in self.wanted),
            family="moteus",
            emergency_stop=self._commands(STOP),
            identity_requests=tuple(self._commands(kernels.pad(ask)) for ask in (WHO, WHICH)),
            command_delay_ticks=1,
            reactions=(self._reaction,),
            dangers=(_BRAKES, _TIME_IS_OVER.format(does)),
        )

    def requests(self, watchdog_s: float) -> tuple[tuple[Frame, ...], ...]:
        """Return a stop, whatever is asked for but torque, and torque; each with its query."""
        torque = kernels.pad(torque_command(0.0, self.torque_limit, watchdog_s))
        return tuple(self._commands(data) for data in (STOP, STOP, STOP, torque))

    def _commands(self, data: bytes) -> tuple[Frame, ...]:
        first, flags = REPLY_WANTED | self.host << 8, EXTENDED | FD | BRS
        return self.to_each(Frame(first | node, data, flags) for node in self.nodes)

    def said_by(self, frame: Frame) -> Said | None:
        """Return the serial number, 96 bits, or the version of the firmware as the revision."""
        identifier, data, flags = frame
        if identifier not in self.wanted or flags & (kernels.STRANGE | FD) != FD:
            return None
        values = np.full(1 + len(_SERIAL), nan)
        has = kernels.read(data, len(data), kernels.REPLY, (kernels.FIRMWARE, *_SERIAL), values)
        words = values.tolist()[:1] if has & 1 else values.tolist()[1:]
        strays = has < 0 or bool(flags & EXTENDED) != (identifier > 0x7FF)
        if strays or not all(map(float.is_integer, words)):
            return None
        number = sum((int(word) & _WORD) << 32 * k for k, word in enumerate(words))
        return Said(self.wanted.index(identifier), REVISION if has & 1 else SERIAL, number)
