"""Enumerations for the integers of a tick (states, modes, faults, warnings), and the command to the drives.

Every reader treats arrays as read-only.
"""

from enum import IntEnum, IntFlag
from typing import NamedTuple

from drivers.arrays import Array

LEGS = 6
NEVER = 1_000_000
"""Age in ticks of a leg without any feedback yet."""


class BusState(IntEnum):
    """State of a CAN controller, by its error counters (ISO 11898-1)."""

    UNKNOWN = 0
    """The controller has reported nothing, or the bus has none."""
    ACTIVE = 1
    WARNING = 2
    """An error counter has reached 96."""
    PASSIVE = 3
    """An error counter has reached 128."""
    OFF = 4
    """The transmit counter has passed 255: the controller has left the bus."""


class DriveMode(IntEnum):
    """State that the controller requests of all six drives."""

    OFF = 0
    """Force stage off, brake engaged."""
    READY = 1
    """Force stage on, brake still engaged: the static force can build up against it."""
    RUN = 2
    """Force stage on, brake released."""
    RESET = 3
    """Clear a latched drive fault, then OFF."""


class DriveState(IntEnum):
    """State that one drive reports."""

    BOOT = 0
    """Powered up, not configured; brake engaged."""
    OFF = 1
    READY = 2
    RUN = 3
    FAULT = 4
    """Latched: the reaction is active until RESET; OFF brakes, and stays latched."""


INVALID = 8
"""Added to the state in a feedback without valid length and rate: encoder lost, the drive obeys."""


class Reaction(IntEnum):
    """Reaction of a drive by itself to a fault in RUN, such as a missing command.

    An emergency stop always brakes, and so does a fault outside RUN: no fault opens a closed brake.
    """

    BRAKE = 0
    """Force off, brake engaged."""
    DAMP = 1
    """Viscous force against the measured rate, brake open."""
    HOLD = 2
    """Local position hold at the length of the fault instant, brake open."""
    ZERO = 3
    """Force zero, brake open."""


class DriveFault(IntEnum):
    """Reason why a drive is in FAULT, as far as it is common to several drive protocols."""

    NONE = 0
    WATCHDOG = 1
    ESTOP = 2
    OVERFORCE = 3
    SENSOR = 4
    STROKE = 5


class Mode(IntEnum):
    """Phase of the controller between rest and motion."""

    WAITING = 0
    """Not all six drives have reported, are configured and off yet."""
    IDLE = 1
    """Drives present and off, brakes engaged."""
    LOADING = 2
    """Drives ready, brakes engaged. Brake test: they carry the platform without force, and the legs must not
    move; then the holding force builds up."""
    RELEASING = 3
    """Brakes opening at the holding force."""
    APPROACH = 4
    """Quintic move from the measured pose to the start of the reference."""
    TRACKING = 5
    STOPPING = 6
    """Decelerating along the reference to rest."""
    PARKING = 7
    """At rest; brakes engage, the force stays until all six drives report them closed."""
    UNLOADING = 8
    """Brake test: the force fades out on the closed brakes, and the legs must not move."""
    PARKED = 9
    """Done: drives off, brakes engaged."""
    FAULT = 10
    """Latched: drives commanded off."""
    HELD = 11
    """Latched, with the force on: not all brakes are proven shut. They are engaged, and the law holds the
    platform, until the operator releases it."""


class Refusal(IntFlag):
    """Reason why a set-point was refused, or not followed to its end; one bit each."""

    NONE = 0
    NOT_TRACKING = 1
    NOT_A_POSE = 2
    """The pose is not finite, or rotates by more than half a turn."""
    STROKE = 4
    CONDITION = 8
    FORCE = 16
    ON_THE_WAY = 32
    """The set-point itself is allowed, the path to it is not."""
    SPEED = 64


class Fault(IntFlag):
    """Reasons for Mode.FAULT, one bit each, that stay until a deliberate reset."""

    NONE = 0
    STALE = 1
    DRIVE = 2
    """A drive faulted, left its state, or did not reach the next one in time."""
    BUS = 4
    STROKE = 8
    SPEED = 16
    FOLLOWING = 32
    KINEMATICS = 64
    ASSEMBLY = 128
    CONDITION = 256
    NOT_FINITE = 512
    ESTOP = 1024
    LAW = 2048
    ENCODER = 4096
    """A leg's length, rate and force contradict each other (leg in column `legs_doubted`, reason in `doubt`),
    or an encoder that may not be lost contradicts the fused pose."""
    UNCERTAIN = 8192
    """The fused pose is less certain than required."""
    CERTIFICATE = 16384
    """The error grew more than the law's Lyapunov function allows."""
    BRAKE = 32768
    """A leg moved on its closed brake; its bit is in column `legs_moved`."""
    SECOND_CONTROLLER = 65536
    """Another node sent a SYNC, a command or a CONFIG."""
    DUPLICATE_NODE = 131072
    """One node number gave two different answers to one SYNC."""
    REFUSED_FRAMES = 262144
    """Too many ticks had frames of the drives that could not be trusted."""
    SET_UP = 524288
    """A drive reports a set-up other than the one that was sent to it."""


class Doubt(IntEnum):
    """Reason why a leg's length encoder may be wrong."""

    NONE = 0
    JUMP = 1
    """Between two readings the length changed by more or less than its rate allows."""
    SLIP = 2
    """Length and rate contradict each other a little with each reading."""
    LEAP = 3
    """The rate of this leg alone changed by more than forces and disturbance explain."""
    STILL = 4
    """The reading is constant although the leg must move, and stayed so under a probe force."""
    SECOND = 5
    """The second encoder of the leg contradicts it; closed brake or tracker show that it is wrong."""
    EITHER = 6
    """The two encoders of the leg contradict each other, and nothing shows which of them is wrong."""


class Foreign(IntFlag):
    """Kinds of frames received from another controller on the bus, one bit each."""

    NONE = 0
    SYNC = 1
    COMMAND = 2
    CONFIG = 4
    ESTOP = 8
    """Emergency stop, which any node may send."""


class Warn(IntFlag):
    """Limits reached and functions degraded in this tick, one bit each; cleared in the next tick."""

    NONE = 0
    STALE = 1
    LATE = 2
    DEGRADED = 4
    FORCE_LIMIT = 8
    FORCE_STEP = 16
    FORCE_WINDOW = 32
    REJECTED = 64
    RECORDER = 128
    BUS = 256
    """Error frames, lost receptions or refused frames."""
    SETPOINT = 512
    """A set-point was refused."""
    ENCODER = 1024
    """The encoder of a leg is lost or contradicts the fused pose; its bit is in column `legs_lost`."""
    SENSOR = 2048
    """A configured tracker or IMU has been silent or refused for several of its periods."""
    CERTIFICATE = 4096
    """The error grows more than the law's Lyapunov function allows."""


class Stop(IntEnum):
    """Reason why the safety layer requests a controlled stop of the motion."""

    NONE = 0
    MISSED = 1
    """Too many periods missed in a row."""
    RECORDER = 2
    """The recorder is dead or loses ticks, and the run may not continue without it."""
    STRETCHED = 3
    """The virtual bench's clock stood still for too much of the run."""


class Command(NamedTuple):
    """One tick's command to the six drives."""

    mode: DriveMode
    force: Array
    """Leg forces (6,) N, > 0 extends."""
    stop: bool = False
    """True if an emergency stop is sent with the command."""
