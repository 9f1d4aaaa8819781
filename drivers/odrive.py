"""Codec of ODrive CAN Simple, firmware 0.6: torque control of axes whose encoders are polled.

Identifier: node << 5 | command. Each tick requests Get_Encoder_Estimates by a remote frame, and sends
Set_Input_Torque, which feeds the axis' watchdog. The heartbeat has state and error, Estop latches,
Clear_Errors clears. Fields are little-endian, float32 in turns, turns/s and N m (ODrive documentation, CAN
Protocol).
An axis also sends its estimates by a timer, under the identifier of its answer: every 10 ms by factory
setting. No frame tells the two apart, so the newest of a tick counts, and two different ones do not mean a
second axis.
Only the heartbeat reports the state, and it comes by a timer, not with a change. So an axis gets its torque
from the tick of the command for closed loop on; the command is repeated if a later heartbeat reports another
state. After RUN it counts as enabled, and gets IDLE, until a heartbeat reports otherwise. A reset clears
the errors of each axis, whatever its last heartbeat reported.
The watchdog is a setting of the axis (`config.enable_watchdog`, `watchdog_timeout`), off by factory setting.
No message of CAN Simple sets it, so `drives.watchdog_ms` states the value set with odrivetool.
"""

import struct
from functools import cached_property
from math import ceil
from typing import Any

import numpy as np

from drivers import motor_kernels as motors
from drivers.config import BusSettings, DriveSettings
from drivers.errors import ConfigurationError
from drivers.frame_pointers import place_of, whole
from drivers.motor_kernels import PREPARES
from drivers.motor_settings import Options, refuse_torque
from drivers.motors import ANY, MotorProtocol, push
from drivers.protocol import ERROR, EXTENDED, FD, REMOTE, SERIAL, STRANGE, Frame, Said, Traits

ADDRESS = 0x06
"""Requested by a remote frame; the answer has node number, serial number and connection."""
HEARTBEAT, ESTOP, AXIS_STATE, ESTIMATES, MODES, TORQUE, CLEAR = 0x01, 0x02, 0x07, 0x09, 0x0B, 0x0E, 0x18
IDLE, CLOSED_LOOP = 1, 8
"""Axis states of an ODrive."""
TORQUE_CONTROL = 1
"""ODrive's control mode for torque."""
COMMANDS = sum(
    1 << kind
    for kind in {
        ESTOP, AXIS_STATE, MODES, TORQUE, CLEAR,
        0x04, ADDRESS, 0x0C, 0x0D, *range(0x0F, 0x14), 0x16, 0x19, 0x1A, 0x1B, 0x1F,
    }
)  # fmt: skip
"""Bit mask: bit k is set if a controller sends command k with data."""
WATCHDOG_EXPIRED, STOP_REQUESTED = 0x1000000, 0x2000000
"""Errors of an axis that correspond to a DriveFault."""
NOT_OURS = EXTENDED | FD | ERROR


@motors.hearing
def hear(ear: Any, frame: Any, heard: Any) -> int:
    """Decode encoder estimates or a heartbeat into `heard` (HEARD record); 0: neither."""
    identifier, data = int(frame.id), frame.data
    node, kind = identifier >> 5, identifier & 0x1F
    leg = place_of(node, ear.nodes)
    if frame.flags & STRANGE or identifier > 0x7FF or leg < 0:
        return 0
    if COMMANDS >> kind & 1:
        # a message that sets an address has another node
        own_address = kind == ADDRESS and frame.length == 8 and data[0] == node
        return 0 if own_address else motors.says(heard, leg, motors.FOREIGN)
    if kind not in (HEARTBEAT, ESTIMATES):
        return 0
    if frame.length != 8:
        return motors.says(heard, leg, motors.BROKEN)
    if kind == HEARTBEAT:
        motors.says(heard, leg, 0)
        return motors.powers(ear, heard, whole(data, 0), data[4] == CLOSED_LOOP)
    turns, speed = motors.single(data, 0), motors.single(data, 4)
    if not (np.isfinite(turns) and np.isfinite(speed)):
        return motors.says(heard, leg, motors.FEEDBACK)
    motors.says(heard, leg, motors.FEEDBACK | motors.MOTION)
    heard.turns, heard.speed = turns, speed
    return 1


PASSTHROUGH = 1
"""ODrive's input mode without filter."""
UNASKED = "encoder_msg_rate_ms"
"""Setting of an axis, and option here: period of its unrequested estimates, ms; 0: none."""
DELIVERED_MS, MOST_UNASKED_MS = 10, 10_000
"""Factory setting; and the limit above which a value is a mistake."""
MISSED_BEATS = 3
MOST_HEARTBEAT_MS = 250.0
"""Start and parking wait one second for the heartbeats of all axes; some may be lost."""
ERRORS = {
    0x1: "initializing",
    0x2: "system level",
    0x4: "timing error",
    0x8: "missing estimate",
    0x10: "bad configuration",
    0x20: "gate driver fault",
    0x40: "missing input",
    0x100: "DC bus over voltage",
    0x200: "DC bus under voltage",
    0x400: "DC bus over current",
    0x800: "DC bus over regeneration current",
    0x1000: "current limit violation",
    0x2000: "motor over temperature",
    0x4000: "inverter over temperature",
    0x8000: "velocity limit violation",
    0x10000: "position limit violation",
    0x1000000: "watchdog timer expired",
    0x2000000: "emergency stop requested",
    0x4000000: "spinout detected",
    0x8000000: "brake resistor disarmed",
    0x10000000: "thermistor disconnected",
    0x40000000: "calibration error",
}
_MAX_TORQUE = 1e4
"""N m: a larger value is a mistake, although a single can hold it."""
_BRAKES = (
    "drives.protocol: an axis operates its own brake, open only in CLOSED_LOOP_CONTROL, and no "
    "message of CAN Simple sets or reads this: set its pin with odrivetool, "
    "mechanical_brake.config.gpio_num and is_active_low, else a platform without power falls; the "
    "brake tests check it"
)
_WATCHDOGS = (
    "drives.watchdog_ms: CAN Simple cannot set or read the watchdog of an axis, off by factory setting: "
    "set config.watchdog_timeout and config.enable_watchdog with odrivetool, else an axis keeps its "
    "last torque without end when the controller stops"
)


class ODriveProtocol(MotorProtocol):
    """Codec of six ODrive axes."""

    ear, commanding, rule = hear, push, PREPARES
    silence, stopped = WATCHDOG_EXPIRED, STOP_REQUESTED
    number_at = 5, ANY
    torque_limit = _MAX_TORQUE
    fault_names, fault_bits = ERRORS, True

    def __init__(self, bus: BusSettings, drives: DriveSettings) -> None:
        options = Options(bus, drives, "odrive", "classic", (UNASKED,))
        transmission, nodes = options.transmission, drives.node_ids
        self._unasked_s = 1e-3 * options.whole(UNASKED, DELIVERED_MS, 0, MOST_UNASKED_MS)
        if drives.heartbeat_ms > MOST_HEARTBEAT_MS:
            raise ConfigurationError(
                f"drives.heartbeat_ms: allowed with odrive: up to {MOST_HEARTBEAT_MS:g}, as only the "
                f"heartbeat reports whether an axis is enabled, given: {drives.heartbeat_ms:g}"
            )
        refuse_torque(transmission, drives.force_limit_N, _MAX_TORQUE, "odrive")
        answers = tuple(node << 5 | ESTIMATES for node in nodes)
        super().__init__(transmission, nodes, (0, 32, 0.0), bus.legs, answers)
        self.delivered_s, self._heartbeat_s = 1e-3 * drives.watchdog_ms, 1e-3 * drives.heartbeat_ms
        self.refuse_nodes(0, 62, "odrive")  # 63 is "not set"
        self.polls = self._to_each(ESTIMATES, b"", REMOTE)

    def _to_each(self, command: int, data: bytes, flags: int = 0) -> tuple[Frame, ...]:
        return self.to_each(Frame(node << 5 | command, data, flags) for node in self.nodes)

    # controller's end

    @cached_property
    def traits(self) -> Traits:
        """Properties of ODrive axes: Estop latches, and a remote frame requests an axis's serial number."""
        return self.traits_of(
            self._to_each(ESTIMATES, bytes(8)),
            family="odrive",
            emergency_stop=self._to_each(ESTOP, b""),
            identity_requests=(self._to_each(ADDRESS, b"", REMOTE),),
            unasked_s=self._unasked_s,
            stop_latches=True,
            power_told="heartbeat",
            reports_force=False,
            dangers=(_BRAKES, _WATCHDOGS),
        )

    def patience_ticks(self, rate_Hz: float) -> int:
        """Ticks in `MISSED_BEATS` heartbeat periods: only heartbeats report whether an axis is enabled."""
        return max(ceil(MISSED_BEATS * self._heartbeat_s * rate_Hz), 2)

    def requests(self, _watchdog_s: float) -> tuple[tuple[Frame, ...], ...]:
        """Frames by purpose: idle, clear errors, closed loop, torque, set the control mode."""
        asked = (
            (AXIS_STATE, struct.pack("<Ixxxx", IDLE)),
            (CLEAR, b"\0"),
            (AXIS_STATE, struct.pack("<Ixxxx", CLOSED_LOOP)),
            (TORQUE, bytes(8)),
            (MODES, struct.pack("<II", TORQUE_CONTROL, PASSTHROUGH)),
        )
        return tuple(self._to_each(*each) for each in asked)

    def said_by(self, frame: Frame) -> Said | None:
        """Serial number in an axis's address message; None for others, and for one that sets an address."""
        identifier, data, flags = frame
        leg = self.legs_of.get(identifier >> 5)
        if leg is None or identifier & 0x1F != ADDRESS or flags & STRANGE or len(data) != 8:
            return None
        return Said(leg, SERIAL, int.from_bytes(data[1:7], "little")) if data[0] == identifier >> 5 else None
