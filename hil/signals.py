"""What flows through one tick, in that order: TickInput, State, Reference, Effort, Verdict, TickOutput.

Rule of the room: values only; arrays are read-only to every reader.
"""

from __future__ import annotations

from enum import IntEnum, IntFlag
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.protocol import Frame, Received

Array = NDArray[np.float64]


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
    """At rest; brakes engage, then force off."""
    PARKED = 8
    """Done: drives off, brakes engaged."""
    FAULT = 9
    """Latched: drives commanded off."""


class Operator(IntEnum):
    """Operator commands, an input of the cycle like any other."""

    ENGAGE = 1
    STOP = 2
    RESET = 3
    ESTOP = 4


class Fault(IntFlag):
    """Latched reasons for Mode.FAULT, one bit each."""

    NONE = 0
    STALE = 1
    DRIVE = 2
    BUS = 4
    FORCE = 8
    STROKE = 16
    SPEED = 32
    FOLLOWING = 64
    KINEMATICS = 128
    ASSEMBLY = 256
    CONDITION = 512
    NOT_FINITE = 1024
    MISSED = 2048
    RECORDER = 4096
    ESTOP = 8192
    LAW = 16384


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
    """Frames of the previous tick that the bus did not take."""
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


class Reference(NamedTuple):
    """Where the platform should be."""

    p: Array
    R: Array
    twist: Array
    dtwist: Array
    q: Array
    dq: Array
    ddq: Array


class Effort(NamedTuple):
    """What the law asks for."""

    tau: Array
    """(6,) N, > 0 extends."""


class Verdict(NamedTuple):
    """What safety makes of it."""

    tau: Array
    """(6,) N, limited."""
    warnings: Warn
    faults: Fault


class TickOutput(NamedTuple):
    """The frames to send and the record row."""

    frames: tuple[Frame, ...]
    row: NDArray[np.void]
    """One element of ROW."""


INPUT_COLUMNS: list[tuple[str, str]] = [
    ("tick", "<i8"),
    ("t_ns", "<i8"),
    ("lateness_ns", "<i8"),
    ("skipped", "<i8"),
    ("sends_failed", "<i8"),
    ("bus_errors", "<i8"),
    ("bus_off", "<i8"),
    ("bus_overflow", "<i8"),
    ("recorder_alive", "<i8"),
    ("recorder_dropped", "<i8"),
    ("compute_ns", "<i8"),
]
"""Columns of the row that replay reads back as TickInput (frames and operator commands have channels)."""

COMPUTED_COLUMNS: list[tuple[str, str] | tuple[str, str, tuple[int, ...]]] = [
    ("frames_received", "<i8"),
    ("frames_crc32", "<i8"),
    ("mode", "<i8"),
    ("faults", "<i8"),
    ("warnings", "<i8"),
    ("drive_state", "<i8", (6,)),
    ("drive_fault", "<i8", (6,)),
    ("age", "<i8", (6,)),
    ("rejected", "<i8"),
    ("q", "<f8", (6,)),
    ("dq", "<f8", (6,)),
    ("drive_force", "<f8", (6,)),
    ("p", "<f8", (3,)),
    ("R", "<f8", (9,)),
    ("twist", "<f8", (6,)),
    ("fk_iterations", "<i8"),
    ("fk_residual", "<f8"),
    ("p_d", "<f8", (3,)),
    ("R_d", "<f8", (9,)),
    ("twist_d", "<f8", (6,)),
    ("dtwist_d", "<f8", (6,)),
    ("q_d", "<f8", (6,)),
    ("dq_d", "<f8", (6,)),
    ("ddq_d", "<f8", (6,)),
    ("tau_law", "<f8", (6,)),
    ("tau", "<f8", (6,)),
    ("command_mode", "<i8"),
    ("reference_time_s", "<f8"),
]

ROW = np.dtype([*INPUT_COLUMNS, *COMPUTED_COLUMNS])
"""One tick of the log. Every element is eight bytes: i8 or f8."""
