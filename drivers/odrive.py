"""ODrive CAN Simple of firmware 0.6, both ends: torque control of axes that are asked for their encoders.

Identifier: node << 5 | command. Each tick asks for Get_Encoder_Estimates by a remote frame, and sends
Set_Input_Torque, which feeds the axis' watchdog. The heartbeat has state and error, Estop latches,
Clear_Errors clears. Fields are little-endian, singles in turns, turns/s and N m (ODrive documentation, CAN
Protocol).
An axis sends its estimates by a timer, too, under the identifier of its answer: every 10 ms as delivered. No
frame tells the two apart, so the newest of a tick counts, and two that differ are no second axis.
The heartbeat alone tells the state, and comes by a timer, not with a change. So an axis gets its torque from
the tick on in which it is asked to close its loop; it is asked again where a later heartbeat says that it has
not. When RUN is over it counts as enabled, and is told IDLE, until a heartbeat says otherwise; and a reset
clears the errors of each axis, whatever the last one said.
The watchdog is a setting of the axis (`config.enable_watchdog`, `watchdog_timeout`), off as delivered; no
message of CAN Simple sets it, so `drives.watchdog_ms` says what has been set with odrivetool.
"""

import struct
from collections.abc import Sequence
from math import ceil

from drivers import odrive_kernels as kernels
from drivers.config import BusSettings, DriveSettings
from drivers.errors import ConfigurationError
from drivers.identity import SERIAL, Said
from drivers.motor_device_kernels import ANY
from drivers.motor_drives import codes_of
from drivers.motor_kernels import PREPARES
from drivers.motor_settings import Options, refuse_layout, refuse_torque, required
from drivers.motors import MotorProtocol
from drivers.protocol import (
    ALL_LEGS,
    REMOTE,
    Answer,
    DeviceMessage,
    EmergencyStop,
    Frame,
)
from drivers.signals import DriveFault
from drivers.tick_columns import Record
from drivers.transmission import Transmission

PASSTHROUGH = 1
"""Input mode."""
UNASKED = "encoder_msg_rate_ms"
"""Setting of an axis, and option here: how often it sends its estimates unasked; 0: never."""
DELIVERED_MS, MOST_UNASKED_MS = 10, 10_000
"""Of an axis as delivered; and what is a mistake above."""
MISSED_BEATS = 3
MOST_HEARTBEAT_MS = 250.0
"""A start, and parking, wait for a second for what the heartbeats of all axes say; some may be lost."""
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
_FAULTS = {
    DriveFault.WATCHDOG: kernels.WATCHDOG_EXPIRED,
    DriveFault.ESTOP: kernels.STOP_REQUESTED,
    DriveFault.OVERFORCE: 0x1000,
    DriveFault.SENSOR: 0x8,
    DriveFault.STROKE: 0x10000,
}
_MAX_TORQUE = 1e4
"""N m: more is a mistake, whatever a single can hold."""
_BRAKES = (
    "drives.protocol: an axis works its brake by itself, open in CLOSED_LOOP_CONTROL alone, and no "
    "message of CAN Simple sets or reads that: give it the pin with odrivetool, "
    "mechanical_brake.config.gpio_num and is_active_low, else a platform without power falls; the "
    "brake tests test it"
)
_WATCHDOGS = (
    "drives.watchdog_ms: CAN Simple cannot set or read the watchdog of an axis, off as delivered: "
    "set config.watchdog_timeout and config.enable_watchdog with odrivetool, else an axis keeps its "
    "last torque for ever when the controller stops"
)


class ODriveProtocol(MotorProtocol):
    """The tables of six axes."""

    ear, commanding, rule = kernels.hear, kernels.push, PREPARES
    obey, encode, reporting = kernels.obey, kernels.encode, kernels.beat
    number_at = 5, ANY
    rejections = (
        "command {kind:#x} of {size} bytes",
        "command {kind:#x} is not emulated",
        "axis state {0:.0f}",
        "closed loop without torque control",
        "torque that is no number",
    )
    command_delay_ticks = 0
    stop_latches = True
    shares_identifiers = False
    power_told = "heartbeat"
    torque_limit = _MAX_TORQUE
    dangers = _BRAKES, _WATCHDOGS
    fault_names, fault_bits = ERRORS, True

    def __init__(
        self,
        nodes: Sequence[int],
        watchdog_s: float,
        transmission: Transmission,
        heartbeat_s: float = 0.1,
        unasked_s: float = 0.0,
        legs: Sequence[Sequence[int]] = (ALL_LEGS,),
    ) -> None:
        """Take six node numbers, the watchdog and timers that odrivetool has set, and the legs of each bus.

        Raises ConfigurationError for a node over 62: 63 is "not set".
        """
        answers = tuple(node << 5 | kernels.ESTIMATES for node in nodes)
        super().__init__(transmission, nodes, (0, 32, 0.0), legs, answers)
        self.delivered_s, self._heartbeat_s, self.unasked_s = watchdog_s, heartbeat_s, unasked_s
        self.refuse_nodes(0, 62, "odrive")
        self.tables["codes"] = codes_of(_FAULTS, 0)
        self.polls = self._to_each(kernels.ESTIMATES, b"", REMOTE)

    def _to_each(self, command: int, data: bytes, flags: int = 0) -> tuple[Frame, ...]:
        return self.to_each(Frame(node << 5 | command, data, flags) for node in self.nodes)

    # controller's end

    def patience_ticks(self, rate_Hz: float) -> int:
        """Return the ticks of `MISSED_BEATS` heartbeats: these alone tell whether an axis is enabled."""
        return max(ceil(MISSED_BEATS * self._heartbeat_s * rate_Hz), 2)

    def requests(self, _watchdog_s: float) -> tuple[tuple[Frame, ...], ...]:
        """Return what makes an axis idle, clears its errors, closes its loop, is its torque and its mode."""
        asked = (
            (kernels.AXIS_STATE, struct.pack("<Ixxxx", kernels.IDLE)),
            (kernels.CLEAR, b"\0"),
            (kernels.AXIS_STATE, struct.pack("<Ixxxx", kernels.CLOSED_LOOP)),
            (kernels.TORQUE, bytes(8)),
            (kernels.MODES, struct.pack("<II", kernels.TORQUE_CONTROL, PASSTHROUGH)),
        )
        return tuple(self._to_each(*each) for each in asked)

    def identity_requests(self) -> tuple[tuple[Frame, ...], ...]:
        """Return remote frames for the address of each axis."""
        return (self._to_each(kernels.ADDRESS, b"", REMOTE),)

    def said_by(self, frame: Frame) -> Said | None:
        """Return the serial number of an address that names its own node: one that sets it names another."""
        identifier, data, flags = frame
        leg = self.legs_of.get(identifier >> 5)
        if (
            leg is None
            or identifier & 0x1F != kernels.ADDRESS
            or flags & (kernels.STRANGE | REMOTE)
            or len(data) != 8
        ):
            return None
        return Said(leg, SERIAL, int.from_bytes(data[1:7], "little")) if data[0] == identifier >> 5 else None

    def emergency_stop(self) -> tuple[Frame, ...]:
        """Return Estop for each axis: it latches."""
        return self._to_each(kernels.ESTOP, b"")

    # drives' end

    def converse(self, d: Record, leg: int | None, frame: Frame) -> tuple[DeviceMessage, ...]:
        """Take Estop, or the question for the address."""
        assert leg is not None
        node = self.nodes[leg]
        if frame.id & 0x1F == kernels.ADDRESS:
            said = bytes((node,)) + node.to_bytes(6, "little") + b"\0"
            return (Answer(leg, self.to_leg(leg, Frame(frame.id, said))),)
        d["enabled"][leg] = 0
        return (EmergencyStop((leg,)),)


def odrive(bus: BusSettings, drives: DriveSettings) -> ODriveProtocol:
    """Return the codec of a configuration. Raises ConfigurationError for settings that it does not have."""
    refuse_layout(bus, "odrive", "classic")
    transmission = required(drives.transmission, "odrive")
    options = Options(drives.options, "odrive", (UNASKED,))
    unasked_ms = options.whole(UNASKED, DELIVERED_MS, 0, MOST_UNASKED_MS)
    if drives.heartbeat_ms > MOST_HEARTBEAT_MS:
        raise ConfigurationError(
            f"drives.heartbeat_ms: allowed with odrive: up to {MOST_HEARTBEAT_MS:g}, as the heartbeat alone "
            f"tells whether an axis is enabled, given: {drives.heartbeat_ms:g}"
        )
    refuse_torque(transmission, drives.force_limit_N, _MAX_TORQUE, "odrive")
    return ODriveProtocol(
        drives.node_ids,
        1e-3 * drives.watchdog_ms,
        transmission,
        1e-3 * drives.heartbeat_ms,
        1e-3 * unasked_ms,
        bus.legs,
    )
