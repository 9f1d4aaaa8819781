"""The record of one tick: the table of its columns, and the NumPy type made from it.

A tick is one structured array of no dimension. Decoder, estimators, reference, law and safety fill the
columns of their parts. The recorded columns come first, and the log stores them unchanged. The table is below
`hil` because the decoders fill it. A new column is one row here and its use in the stage that fills it.
"""

from __future__ import annotations

from enum import IntEnum, IntFlag
from math import prod
from typing import Any, Literal, NamedTuple

import numpy as np

from drivers.arrays import array_at
from drivers.signals import (
    LEGS,
    NEVER,
    BusState,
    Doubt,
    DriveFault,
    DriveMode,
    DriveState,
    Fault,
    Foreign,
    Mode,
    Refusal,
    Warn,
)

LegBits = IntFlag("LegBits", ["LEG_0", "LEG_1", "LEG_2", "LEG_3", "LEG_4", "LEG_5"])
"""Bit i for leg i."""

Record = np.ndarray[Any, np.dtype[np.void]]
"""One element of TICK, of no dimension: ``record["q"]`` is a view of that column."""

Part = Literal["input", "measurement", "estimate", "fusion", "reference", "effort", "verdict", "output"]
"""Stage that fills a column."""


class Column(NamedTuple):
    """One column; each of its elements takes eight bytes."""

    part: Part
    """Stage that fills it; `output` in a log."""
    name: str
    """Name of the field in the log's message."""
    type: type[int | float | IntEnum | IntFlag]
    """int64 or float64; an enumeration gives names to the numbers of an int64, or to their bits."""
    unit: str
    """Unit of its elements; empty without one."""
    meaning: str
    """Meaning, in a phrase."""
    elements: tuple[str, ...] = ()
    """Names of its elements, row by row; empty for a scalar."""
    shape: tuple[int, ...] = ()
    """Shape within a row; empty for a scalar."""

    @property
    def kind(self) -> str:
        """NumPy's name of its type."""
        return "<f8" if self.type is float else "<i8"

    @property
    def size(self) -> int:
        """Number of elements."""
        return prod(self.shape)

    @property
    def names(self) -> dict[str, int]:
        """Names of its numbers, or of their bits; empty without names."""
        if not issubclass(self.type, (IntEnum, IntFlag)):
            return {}
        return {str(member.name): int(member) for member in self.type}

    @property
    def labels(self) -> tuple[str, ...]:
        """Name of each element, row by row, such as `tau.leg_3`, `p.z`; for a scalar the column's name."""
        if not self.shape:
            return (self.name,)
        places = ("_".join(map(str, place)) for place in np.ndindex(self.shape))
        return tuple(f"{self.name}.{element}" for element in self.elements or places)

    @property
    def units(self) -> tuple[str, ...]:
        """Unit of each element, row by row; for `m, rad` the first half is m, the second half rad."""
        units = tuple(self.unit.split(", "))
        if not self.shape or self.size % len(units):
            return (self.unit,) * self.size
        return tuple(unit for unit in units for _ in range(self.size // len(units)))


PER_LEG = tuple(f"leg_{leg}" for leg in range(LEGS))
XYZ = ("x", "y", "z")
POSE = (*XYZ, "rx", "ry", "rz")
TWIST = ("vx", "vy", "vz", "wx", "wy", "wz")
WRENCH = ("fx", "fy", "fz", "mx", "my", "mz")
MATRIX = tuple(row + column for row in XYZ for column in XYZ)


def column(part: Part, name: str, kind: Any, unit: str, meaning: str, *elements: str) -> Column:
    """Column whose shape follows from the names of its elements."""
    shape = (3, 3) if elements == MATRIX else (len(elements),) if elements else ()
    return Column(part, name, kind, unit, meaning, elements, shape)


_ = column
RECORDED = (
    _("input", "tick", int, "", "number of the tick"),
    _("input", "t_ns", int, "ns", "scheduled time on the monotonic clock"),
    _("input", "lateness_ns", int, "ns", "how late the loop woke up"),
    _("input", "skipped", int, "", "whole periods skipped just before"),
    _("input", "stretched_ns", int, "ns", "virtual bench: how long time stood still since the last tick"),
    _("input", "sync_skew_ns", int, "ns", "from the first bus's SYNC or poll of this tick to the last bus's"),
    _("input", "sends_failed", int, "", "frames that the bus did not take since the last tick's command"),
    _("input", "bus_errors", int, "", "error frames since the last tick"),
    _("input", "bus_off", int, "", "1 while the bus is off; of several, bit i for the i-th"),
    _("input", "bus_overflow", int, "", "receive overflows since the last tick"),
    _("input", "bus_state", BusState, "", "the worst of the CAN controller since the last tick"),
    _("input", "recorder_alive", int, "", "1 while the recorder lives"),
    _("input", "recorder_dropped", int, "", "ticks that the recorder has lost so far"),
    _("input", "compute_ns", int, "ns", "time that the last tick's step took"),
    _("input", "latch_ns", int, "ns", "from the wake-up to when each drive latched its encoder", *PER_LEG),
    _("input", "frames_received", int, "", "frames that this tick consumed"),
    _("input", "frames_crc32", int, "", "CRC-32 of those frames"),
    _("output", "mode", Mode, "", "where the controller is between rest and motion"),
    _("output", "faults", Fault, "", "latched faults"),
    _("output", "warnings", Warn, "", "what was limited or degraded in this tick"),
    _("measurement", "rejected", int, "", "frames of this tick that were refused"),
    _("measurement", "foreign", Foreign, "", "frames of another controller in this tick"),
    _("measurement", "doubled", LegBits, "", "nodes that answered one SYNC twice, and not the same"),
    _("measurement", "altered", LegBits, "", "drives that report another set-up than the one sent"),
    _("output", "command_mode", DriveMode, "", "what the drives are asked for"),
    _("estimate", "fk_iterations", int, "", "Newton steps of forward kinematics"),
    _("output", "setpoints_taken", int, "", "set-points taken so far"),
    _("output", "setpoints_refused", int, "", "set-points refused so far"),
    _("output", "setpoint_refusal", Refusal, "", "why set-points were refused in this tick"),
    _("fusion", "legs_used", LegBits, "", "encoders that the fused pose used"),
    _("fusion", "legs_lost", LegBits, "", "encoders that do not count: silent, invalid or slipped"),
    _("fusion", "legs_slipped", LegBits, "", "encoders that have slipped"),
    _("fusion", "tracker", int, "", "1 this tick's tracker sample was used, -1 refused, 0 there was none"),
    _("measurement", "drive_state", DriveState, "", "what each drive reports", *PER_LEG),
    _("measurement", "drive_fault", DriveFault, "", "why a drive is in FAULT", *PER_LEG),
    _("measurement", "age", int, "ticks", f"since the last fresh feedback; {NEVER}: none yet", *PER_LEG),
    _("estimate", "q", float, "m", "leg length, joint centre to joint centre", *PER_LEG),
    _("estimate", "dq", float, "m/s", "leg rate", *PER_LEG),
    _("measurement", "drive_force", float, "N", "force that the drive reports, > 0 extends", *PER_LEG),
    _("estimate", "p", float, "m", "platform origin in the base frame", *XYZ),
    _("estimate", "R", float, "1", "x_base = p + R x_platform", *MATRIX),
    _("estimate", "twist", float, "m/s, rad/s", "velocity of the platform origin; omega; base frame", *TWIST),
    _("reference", "p_d", float, "m", "reference of p", *XYZ),
    _("reference", "R_d", float, "1", "reference of R", *MATRIX),
    _("reference", "twist_d", float, "m/s, rad/s", "reference of the twist", *TWIST),
    _("reference", "dtwist_d", float, "m/s^2, rad/s^2", "its rate", *TWIST),
    _("reference", "q_d", float, "m", "reference of the leg length", *PER_LEG),
    _("reference", "dq_d", float, "m/s", "its rate", *PER_LEG),
    _("reference", "ddq_d", float, "m/s^2", "its second rate", *PER_LEG),
    _("effort", "tau_law", float, "N", "leg force that the law asks for, > 0 extends", *PER_LEG),
    _("effort", "tau_learned", float, "N", "learned leg force, of what is asked for", *PER_LEG),
    _("verdict", "tau", float, "N", "leg force that is sent, > 0 extends", *PER_LEG),
    _("estimate", "wrench", float, "N, N m", "load ON the platform at its origin, base frame", *WRENCH),
    _("estimate", "fk_residual", float, "m", "largest leg residual of forward kinematics"),
    _("estimate", "condition", float, "1", "condition number of J, lengths and angles made comparable"),
    _("reference", "reference_time_s", float, "s", "time along the present motion"),
    _("fusion", "innovation_q", float, "m", "leg length, measured less predicted", *PER_LEG),
    _("fusion", "innovation_tracker", float, "m, rad", "tracker's pose, measured less predicted", *POSE),
    _("fusion", "pose_std", float, "m, rad", "standard deviation of the fused pose, base frame", *POSE),
    _("estimate", "wrench_sensor", float, "N, N m", "what the wrench sensor last said, base frame", *WRENCH),
    _("verdict", "legs_moved", LegBits, "", "legs that moved on their closed brakes"),
    _("effort", "legs_refused", LegBits, "", "legs that get no force: their drives do not obey"),
    _("verdict", "legs_doubted", LegBits, "", "legs whose encoder is doubted, until a reset"),
    _("verdict", "doubt", Doubt, "", "why the first of them is"),
    _("verdict", "doubt_value", float, "m, m/s", "what showed it: a length, or the rate of a LEAP"),
    _("verdict", "doubt_limit", float, "m, m/s", "what noise, forces and disturbance explain of that"),
    _("verdict", "encoder_share", float, "1", "how far length and rate contradict, of the allowed", *PER_LEG),
    _("verdict", "lyapunov", float, "(m/s^2)^2", "V of the law's error dynamics over all axes"),
    _("verdict", "lyapunov_rate", float, "(m/s^2)^2/s", "change of V since the last tick"),
    _("verdict", "lyapunov_bound", float, "(m/s^2)^2", "the largest V that the law's certificate allows"),
    _("verdict", "lyapunov_share", float, "1", "largest sqrt(V) of an axis over what is allowed"),
    _("effort", "probe_force", float, "N", "leg force added to see whether the leg moves", *PER_LEG),
)
"""Columns of the log, in its order."""
LATER = RECORDED[-1:]
"""Columns that older logs lack: nan there, and not compared by a replay."""
WORKING = (
    _("measurement", "length", float, "m", "leg length that the drive last reported", *PER_LEG),
    _("measurement", "rate", float, "m/s", "leg rate that the drive last reported", *PER_LEG),
    _("input", "sensors_rejected", int, "", "of the frames that were refused, those of the sensors"),
    _("measurement", "blind", int, "", "1 where this tick's feedback calls its length of no use", *PER_LEG),
    Column("estimate", "J", float, "m, 1", "dq = J twist", tuple(map(str, range(LEGS**2))), (LEGS, LEGS)),
    _("estimate", "hop", float, "1", "from 1 on the pose may belong to another assembly than the last one"),
    _("measurement", "counted_age", int, "ticks", "as safety judges it: 0 where a leg may be lost", *PER_LEG),
    _("fusion", "unseen", int, "", "1 where the length of a leg is an estimate"),
    _("fusion", "fusion_faults", Fault, "", "what the filter faults"),
    _("fusion", "fusion_warnings", Warn, "", "what the filter warns of"),
    _("reference", "t_d", float, "s", "time along the configured trajectory; nan off it"),
    _("effort", "shortfall", float, "N", "of the last command: force sent less that asked for", *PER_LEG),
    _("effort", "tau_asked", float, "N", "the law's force with what was learned and the ramps", *PER_LEG),
)
"""Columns that exist for one tick only."""
del _
COLUMNS = {column.name: column for column in (*RECORDED, *WORKING)}
INPUT_COLUMNS = tuple(c.name for c in RECORDED if c.part == "input" and not c.name.startswith("frames_"))
"""Columns that replay reads back as TickInput (frames and operator commands have channels of their own)."""
INPUT_ELEMENTS = sum(COLUMNS[name].size for name in INPUT_COLUMNS)
"""Number of elements of these columns."""
COMPUTED_COLUMNS = tuple(c.name for c in RECORDED if c.name not in INPUT_COLUMNS)
"""Columns that replay compares."""


ROW = np.dtype([(c.name, c.kind, c.shape) for c in RECORDED])
"""Type of one tick in the log."""
TICK = np.dtype([(c.name, c.kind, c.shape) for c in COLUMNS.values()])
"""Type of one tick in the loop: ROW, then the columns of WORKING."""
FIRST: Record = np.ndarray((), TICK, np.zeros(TICK.itemsize // 8))
"""Record before the first tick, and start of each later one: no feedback yet, nan in columns that may stay
empty."""
FIRST["tick"], FIRST["age"] = -1, NEVER
for _unfilled in ("t_d", "encoder_share", "lyapunov", "lyapunov_rate", "lyapunov_bound", "lyapunov_share"):
    FIRST[_unfilled] = np.nan
FIRST.flags.writeable = False


def new_record() -> Record:
    """New record that starts as FIRST."""
    return np.ndarray((), TICK, FIRST.base.copy())  # type: ignore[union-attr]


def copy_of(record: Record) -> Record:
    """Copy of a record."""
    return np.ndarray((), TICK, record.reshape(1).view(np.float64).copy())


def tick_at(address: int) -> Record:
    """Record at an address, for Python code."""
    return np.ndarray((), TICK, array_at(address, TICK.itemsize // 8, np.float64))


def row_of(record: Record) -> Record:
    """Recorded columns, one element of ROW over the record's own memory."""
    return np.ndarray((), ROW, record)


def part(*parts: Part) -> tuple[str, ...]:
    """Columns of some parts: those that a kernel may access."""
    return tuple(name for name, column in COLUMNS.items() if column.part in parts)
