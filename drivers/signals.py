"""What the numbers of a tick are called: states of drives and controller, faults, warnings; and Command.

Arrays are treated as read-only by every reader.
"""

from enum import IntEnum, IntFlag
from typing import NamedTuple

from drivers.arrays import Array

LEGS = 6
NEVER = 1_000_000
"""Age in ticks of a leg that has never been heard."""


class BusState(IntEnum):
    """How a CAN controller fares, by its error counters (ISO 11898-1)."""

    UNKNOWN = 0
    """Nothing was heard of it, or the bus has none."""
    ACTIVE = 1
    WARNING = 2
    """A counter has reached 96."""
    PASSIVE = 3
    """A counter has reached 128."""
    OFF = 4
    """The transmit counter has passed 255: it takes no part any more."""


class DriveMode(IntEnum):
    """What the controller asks of all six drives."""

    OFF = 0
    """Force stage off, brake engaged."""
    READY = 1
    """Force stage on, brake still engaged: the static force can build up against it."""
    RUN = 2
    """Force stage on, brake released."""
    RESET = 3
    """Clear a latched drive fault, then OFF."""


class DriveState(IntEnum):
    """What one drive reports."""

    BOOT = 0
    """Powered up, not configured; brake engaged."""
    OFF = 1
    READY = 2
    RUN = 3
    FAULT = 4
    """Latched: the reaction is active until RESET; OFF brakes, and stays latched."""


INVALID = 8
"""Added to the state in a feedback whose length and rate are of no use: encoder lost, the drive obeys."""


class Reaction(IntEnum):
    """What a drive does by itself when it faults in RUN (its command stops, say).

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
    """Why a drive is in FAULT (status message)."""

    NONE = 0
    WATCHDOG = 1
    ESTOP = 2
    OVERFORCE = 3
    SENSOR = 4
    STROKE = 5


class Mode(IntEnum):
    """Where the controller is between rest and motion."""

    WAITING = 0
    """Not all six drives heard, configured and off yet."""
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
    """At rest; brakes engage, the force stays until all six drives report them shut."""
    UNLOADING = 8
    """Brake test: the force fades out on the shut brakes, and the legs must stand still."""
    PARKED = 9
    """Done: drives off, brakes engaged."""
    FAULT = 10
    """Latched: drives commanded off."""
    HELD = 11
    """Latched, with the force on: not all brakes are proven shut. They are engaged, and the law holds the
    platform, until the operator releases it."""


class Refusal(IntFlag):
    """Why a set-point was not taken, or not followed to its end."""

    NONE = 0
    NOT_TRACKING = 1
    NOT_A_POSE = 2
    """Not finite, or turned by more than half a turn."""
    STROKE = 4
    CONDITION = 8
    FORCE = 16
    ON_THE_WAY = 32
    """It is good itself; what lies before it is not."""
    SPEED = 64


class Fault(IntFlag):
    """Latched reasons for Mode.FAULT, one bit each."""

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
    """A leg's length, rate and force contradict each other (column `legs_doubted` says which leg's, `doubt`
    how), or an encoder contradicts the fused pose that may not be lost."""
    UNCERTAIN = 8192
    """The fused pose is less certain than it has to be."""
    CERTIFICATE = 16384
    """The error grew as the law's Lyapunov function forbids."""
    BRAKE = 32768
    """A leg moved on its closed brake; column `legs_moved` says which."""
    SECOND_CONTROLLER = 65536
    """Somebody else sent a SYNC, a command or a CONFIG."""
    DUPLICATE_NODE = 131072
    """Two different answers to one SYNC came from one node number."""
    REFUSED_FRAMES = 262144
    """Too many ticks had frames of the drives that could not be trusted."""
    SET_UP = 524288
    """A drive reports another set-up than the one that was sent to it."""


class Doubt(IntEnum):
    """Why an encoder is doubted."""

    NONE = 0
    JUMP = 1
    """From one reading to the next the length changed by more or less than its rate says."""
    SLIP = 2
    """The same, a little at a time."""
    LEAP = 3
    """The rate of this leg alone changed by more than forces and disturbance explain."""
    STILL = 4
    """The reading stands still while the leg must move, and did not give way to a push."""


class Foreign(IntFlag):
    """Which frames of a controller were heard: the own ones are not."""

    NONE = 0
    SYNC = 1
    COMMAND = 2
    CONFIG = 4
    ESTOP = 8
    """Any node may send it."""


class Warn(IntFlag):
    """Not latched: what was limited or degraded in this tick."""

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
    """The encoder of a leg is lost or contradicts the fused pose; column `legs_lost` says which."""
    SENSOR = 2048
    """A configured tracker or IMU has been silent or refused for several of its periods."""
    CERTIFICATE = 4096
    """The error grows as the law's Lyapunov function forbids."""


class Stop(IntEnum):
    """Why safety asks for a controlled stop."""

    NONE = 0
    MISSED = 1
    """Too many periods missed in a row."""
    RECORDER = 2
    """The recorder is dead or loses ticks, and the run may not go on without it."""
    STRETCHED = 3
    """The time of the virtual bench stood still for too much of the run."""


class Command(NamedTuple):
    """One tick's command to the six drives."""

    mode: DriveMode
    force: Array
    """(6,) N, > 0 extends the leg."""
    stop: bool = False
    """An emergency stop goes with it."""
