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


class Estimate(NamedTuple):
    """The state, and how far it can be trusted."""

    state: State
    condition: float
    """Of J, lengths and angles made comparable; inf where it is singular."""
    hop: float
    """>= 1: not safely reachable from the last pose; forward kinematics may have changed assembly."""


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
    stop: bool = False
    """A controlled stop is asked for: ticks missed in a row, or no recorder."""


class TickOutput(NamedTuple):
    """The frames to send and the record row."""

    frames: tuple[Frame, ...]
    row: NDArray[np.void]
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
    "fk_residual": 1,
    "condition": 1,
    "reference_time_s": 1,
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
