"""What flows through one tick, in that order: TickInput, State, Reference, Effort, Verdict, TickOutput."""

from __future__ import annotations

import math
from collections.abc import Sequence
from enum import IntEnum, IntFlag
from typing import NamedTuple

import numpy as np

from drivers.arrays import Array, Ints, Rows
from drivers.protocol import Frame, Received


class Mode(IntEnum):
    """Where the controller is between rest and motion."""

    WAITING = 0
    """Not all six drives heard, configured and off yet."""
    IDLE = 1
    """Drives present and off, brakes engaged."""
    LOADING = 2
    """Drives ready, brakes engaged, holding force builds up."""
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
    """The force fades out on the shut brakes."""
    PARKED = 9
    """Done: drives off, brakes engaged."""
    FAULT = 10
    """Latched: drives commanded off."""


class Operator(IntEnum):
    """Operator commands, an input of the cycle like any other."""

    ENGAGE = 1
    STOP = 2
    RESET = 3
    ESTOP = 4
    SETPOINT = 5
    """Go to a pose: in a log only; TickInput has the poses as `setpoints`."""


class SetPoint(NamedTuple):
    """A pose to go to: m, and the rotation vector in rad, in the base frame."""

    x: float
    y: float
    z: float
    rx: float
    ry: float
    rz: float


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


REASONS = {
    Refusal.NOT_TRACKING: "the platform does not follow set-points now",
    Refusal.NOT_A_POSE: "it is no pose: six finite numbers, at most 180 deg of turn",
    Refusal.STROKE: "a leg would be outside the soft ends of its stroke",
    Refusal.CONDITION: "it is too near to a singularity (limits.condition)",
    Refusal.FORCE: "a leg could need more than limits.force_N",
}
ON_THE_WAY = "stopped on the way: beyond, "


def explain(refusal: int) -> str:
    """Say why a set-point was refused; empty for one that was taken."""
    reasons = [text for bit, text in REASONS.items() if refusal & bit]
    return (ON_THE_WAY if refusal & Refusal.ON_THE_WAY else "") + "; ".join(reasons)


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
    """An encoder contradicts the fused pose that may not be lost."""
    UNCERTAIN = 8192
    """The fused pose is less certain than it has to be."""
    CERTIFICATE = 16384
    """The error grew as the law's Lyapunov function forbids."""


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


class TickInput(NamedTuple):
    """All that changes a decision of one tick; recorded whole, so that replay is exact."""

    tick: int
    t_ns: int
    """Scheduled time of the tick on the monotonic clock."""
    lateness_ns: int
    """How late the loop woke up."""
    skipped: int
    """Whole periods skipped just before this tick."""
    frames: tuple[Received, ...]
    """Received since the last step, in the order consumed."""
    sends_failed: int
    """Frames that the bus did not take: the previous tick's command and this tick's SYNC."""
    bus_errors: int
    """Error frames since the last tick."""
    bus_off: bool
    bus_overflow: int
    """Receive overflows since the last tick."""
    recorder_alive: bool
    recorder_dropped: int
    """Ticks that the recorder has lost so far."""
    operator: tuple[Operator, ...]
    compute_ns: int
    """Time that the previous step took: recorded, decides nothing."""
    setpoints: tuple[SetPoint, ...] = ()
    """For a live reference, in the order received."""


NO_WRENCH = np.zeros(6)
NO_WRENCH.flags.writeable = False


class State(NamedTuple):
    """The estimate: where the platform is."""

    q: Array
    """(6,) m."""
    dq: Array
    """(6,) m/s."""
    p: Array
    """(3,) m, platform origin in the base frame."""
    R: Array
    """(3, 3), x_base = p + R x_platform."""
    twist: Array
    """(6,) m/s, rad/s: [v of the platform origin; omega], base frame."""
    J: Array
    """(6, 6), dq = J twist."""
    iterations: int
    residual: float
    """m, largest leg residual of forward kinematics; inf when it did not converge."""
    wrench: Array = NO_WRENCH
    """(6,) N, N m, external load ON the platform at its origin, base frame: measured, observed, or zero."""


NOT_FUSED = np.zeros(18)
NOT_FUSED.flags.writeable = False


class Fusion(NamedTuple):
    """What the filter of `hil.estimation.fusion` says of its own work, where it gives the pose."""

    used: int = 0
    """Legs whose encoders were used, bit i for leg i."""
    lost: int = 0
    """Legs whose encoders do not count: silent, blind or slipped, bit i for leg i."""
    slipped: int = 0
    """Legs whose encoders have slipped, bit i for leg i."""
    tracker: int = 0
    """1 this tick's tracker sample was used, -1 refused, 0 there was none."""
    figures: Array = NOT_FUSED
    """(18,): measured less predicted lengths m; measured less predicted pose of the tracker m, rad; the
    pose's own standard deviation m, rad."""
    ages: Ints | None = None
    """(6,) ticks, as safety is to judge them: 0 for a leg that may be lost; None: those of the
    measurement."""
    warnings: Warn = Warn.NONE
    faults: Fault = Fault.NONE


NO_FUSION = Fusion()


class Estimate(NamedTuple):
    """The state, and how far it can be trusted."""

    state: State
    condition: float
    """Of J, lengths and angles made comparable; inf where it is singular."""
    hop: float
    """>= 1: not safely reachable from the last pose; forward kinematics may have changed assembly."""
    fusion: Fusion = NO_FUSION


class Reference(NamedTuple):
    """Where the platform should be."""

    p: Array
    R: Array
    twist: Array
    dtwist: Array
    q: Array
    dq: Array
    ddq: Array
    t: float = math.nan
    """s along the configured trajectory; nan on the way to it, while stopping and at rest."""


class Effort(NamedTuple):
    """What the law asks for."""

    tau: Array
    """(6,) N, > 0 extends."""


class Stop(IntEnum):
    """Why safety asks for a controlled stop."""

    NONE = 0
    MISSED = 1
    """Too many periods missed in a row."""
    RECORDER = 2
    """The recorder is dead or loses ticks, and the run may not go on without it."""


class Verdict(NamedTuple):
    """What safety makes of it."""

    tau: Array
    """(6,) N, limited."""
    warnings: Warn
    faults: Fault
    stop: Stop = Stop.NONE
    """A controlled stop is asked for."""
    certificate: Sequence[float] = (math.nan,) * 4
    """Columns `lyapunov` to `lyapunov_share`; nan where nothing is watched."""


class TickOutput(NamedTuple):
    """The frames to send and the record row."""

    frames: tuple[Frame, ...]
    row: Rows
    """One element of ROW."""


INPUT_COLUMNS = (
    "tick",
    "t_ns",
    "lateness_ns",
    "skipped",
    "sends_failed",
    "bus_errors",
    "bus_off",
    "bus_overflow",
    "recorder_alive",
    "recorder_dropped",
    "compute_ns",
)
"""Columns that replay reads back as TickInput (frames and operator commands have channels of their own)."""

INTEGER_COLUMNS: dict[str, int] = {
    **dict.fromkeys(INPUT_COLUMNS, 1),
    "frames_received": 1,
    "frames_crc32": 1,
    "mode": 1,
    "faults": 1,
    "warnings": 1,
    "rejected": 1,
    "command_mode": 1,
    "fk_iterations": 1,
    "setpoints_taken": 1,
    "setpoints_refused": 1,
    "setpoint_refusal": 1,
    "legs_used": 1,
    "legs_lost": 1,
    "legs_slipped": 1,
    "tracker": 1,
    "drive_state": 6,
    "drive_fault": 6,
    "age": 6,
}
"""Columns of the row that are int64, with their lengths, in order."""

FLOAT_COLUMNS: dict[str, int] = {
    "q": 6,
    "dq": 6,
    "drive_force": 6,
    "p": 3,
    "R": 9,
    "twist": 6,
    "p_d": 3,
    "R_d": 9,
    "twist_d": 6,
    "dtwist_d": 6,
    "q_d": 6,
    "dq_d": 6,
    "ddq_d": 6,
    "tau_law": 6,
    "tau": 6,
    "wrench": 6,
    "fk_residual": 1,
    "condition": 1,
    "reference_time_s": 1,
    "innovation_q": 6,
    "innovation_tracker": 6,
    "pose_std": 6,
    "wrench_sensor": 6,
    "lyapunov": 1,
    "lyapunov_rate": 1,
    "lyapunov_bound": 1,
    "lyapunov_share": 1,
}
"""Columns of the row that are float64, after the integers."""

COMPUTED_COLUMNS = tuple(n for n in (*INTEGER_COLUMNS, *FLOAT_COLUMNS) if n not in INPUT_COLUMNS)
"""What replay compares."""


def _field(name: str, kind: str, length: int) -> tuple[str, str] | tuple[str, str, tuple[int]]:
    return (name, kind) if length == 1 else (name, kind, (length,))


ROW = np.dtype(
    [_field(name, "<i8", length) for name, length in INTEGER_COLUMNS.items()]
    + [_field(name, "<f8", length) for name, length in FLOAT_COLUMNS.items()]
)
"""One tick of the log. Every element is eight bytes, integers first."""
ROW_INTEGERS = sum(INTEGER_COLUMNS.values())
ROW_FLOATS = sum(FLOAT_COLUMNS.values())
