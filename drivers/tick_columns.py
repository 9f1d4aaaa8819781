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
"""One bit for each leg: bit i for leg i."""

Record = np.ndarray[Any, np.dtype[np.void]]
"""One TICK record, of no dimension: ``record["q"]`` is a view of that column."""

Part = Literal[
    "input", "measurement", "sensed", "estimate", "fusion", "reference", "effort", "verdict", "output"
]
"""Stage that fills a column."""


class Column(NamedTuple):
    """One column of the tick record: stage, name, type, unit and shape; 8 bytes per element."""

    part: Part
    """Stage that fills it; `output` in a log."""
    name: str
    """Name of the field in the log's message."""
    type: type[int | float | IntEnum | IntFlag]
    """int64 or float64; an enumeration gives names to the numbers of an int64, or to their bits."""
    unit: str
    """Unit of its elements; empty without one."""
    meaning: str
    """Meaning of the column, for the log and the documentation."""
    elements: tuple[str, ...] = ()
    """Names of its elements, row by row; empty for a scalar."""
    shape: tuple[int, ...] = ()
    """Shape within a row; empty for a scalar."""

    @property
    def kind(self) -> str:
        """NumPy's name of the column's type: `<f8` or `<i8`."""
        return "<f8" if self.type is float else "<i8"

    @property
    def size(self) -> int:
        """Number of elements in the column."""
        return prod(self.shape)

    @property
    def names(self) -> dict[str, int]:
        """Name -> number (or bit) for an enumeration column; empty for others."""
        if not issubclass(self.type, (IntEnum, IntFlag)):
            return {}
        return {str(member.name): int(member) for member in self.type}

    @property
    def labels(self) -> tuple[str, ...]:
        """Name of each element, row-major, such as `tau.leg_3`, `p.z`; for a scalar the column's name."""
        if not self.shape:
            return (self.name,)
        places = ("_".join(map(str, place)) for place in np.ndindex(self.shape))
        return tuple(f"{self.name}.{element}" for element in self.elements or places)

    @property
    def units(self) -> tuple[str, ...]:
        """Unit of each element, row-major; for `m, rad` the first half is m, the second half rad."""
        units = tuple(self.unit.split(", "))
        if not self.shape or self.size % len(units):
            return (self.unit,) * self.size
        return tuple(unit for unit in units for _ in range(self.size // len(units)))


PER_LEG = tuple(f"leg_{leg}" for leg in range(LEGS))
XYZ = ("x", "y", "z")
POSE = (*XYZ, "rx", "ry", "rz")
MOTION = ("wx", "wy", "wz", "fx", "fy", "fz")
TWIST = ("vx", "vy", "vz", "wx", "wy", "wz")
WRENCH = ("fx", "fy", "fz", "mx", "my", "mz")
SENSORS = (
    "tracker", "imu", "wrench", "inclination",
    *(f"length_{leg}" for leg in range(LEGS)), *(f"force_{leg}" for leg in range(LEGS)),
)  # fmt: skip
"""Sensors next to the drives, in the order of `drivers.sensing.layout`."""
MATRIX = tuple(row + column for row in XYZ for column in XYZ)


def column(part: Part, name: str, kind: Any, unit: str, meaning: str, *elements: str) -> Column:
    """Column whose shape follows from the names of its elements: (3, 3), (n,), or () without names."""
    shape = (3, 3) if elements == MATRIX else (len(elements),) if elements else ()
    return Column(part, name, kind, unit, meaning, elements, shape)


_ = column
_AGE = "from the sensor's last sample to the SYNC of this tick; inf: none yet"
RECORDED = (
    _("input", "tick", int, "", "number of the tick"),
    _("input", "t_ns", int, "ns", "scheduled time of the tick, monotonic clock"),
    _("input", "lateness_ns", int, "ns", "delay of the loop's wake-up after t_ns"),
    _("input", "skipped", int, "", "number of whole periods skipped just before this tick"),
    _("input", "stretched_ns", int, "ns", "standstill of virtual time since the last tick"),
    _("input", "sync_skew_ns", int, "ns", "time from the first to the last bus's SYNC or poll of this tick"),
    _("input", "sends_failed", int, "", "frames that the bus refused since the last tick's command"),
    _("input", "bus_errors", int, "", "error frames since the last tick"),
    _("input", "bus_off", int, "", "bit i: bus i is off; with one bus 1 or 0"),
    _("input", "bus_overflow", int, "", "received frames lost by overflow since the last tick"),
    _("input", "bus_state", BusState, "", "worst state of the CAN controller since the last tick"),
    _("input", "recorder_alive", int, "", "1 while the recorder process runs"),
    _("input", "recorder_dropped", int, "", "ticks that the recorder has lost so far"),
    _("input", "compute_ns", int, "ns", "computing time of the last tick's step"),
    _("input", "latch_ns", int, "ns", "time from the wake-up to the sampling of each encoder", *PER_LEG),
    _("input", "frames_received", int, "", "number of received frames that this tick processed"),
    _("input", "frames_crc32", int, "", "CRC-32 of the received frames of this tick"),
    _("output", "mode", Mode, "", "phase of the controller between rest and motion"),
    _("output", "faults", Fault, "", "latched faults, one bit each"),
    _("output", "warnings", Warn, "", "limits and degradations in this tick, one bit each"),
    _("measurement", "rejected", int, "", "number of frames refused in this tick"),
    _("measurement", "foreign", Foreign, "", "kinds of frames of another controller in this tick"),
    _("measurement", "doubled", LegBits, "", "nodes that gave two different answers to one SYNC"),
    _("measurement", "altered", LegBits, "", "drives that report another set-up than the one sent"),
    _("output", "command_mode", DriveMode, "", "state that the drives are commanded to enter"),
    _("estimate", "fk_iterations", int, "", "number of Newton steps of the forward kinematics"),
    _("output", "setpoints_taken", int, "", "number of set-points accepted so far"),
    _("output", "setpoints_refused", int, "", "number of set-points refused so far"),
    _("output", "setpoint_refusal", Refusal, "", "reasons for set-points refused in this tick, bits"),
    _("fusion", "legs_used", LegBits, "", "legs whose encoders the fused pose uses"),
    _("fusion", "legs_lost", LegBits, "", "legs with silent, invalid or slipped encoders"),
    _("fusion", "legs_slipped", LegBits, "", "legs whose encoders have slipped"),
    _("fusion", "tracker", int, "", "tracker sample of this tick: 1 used, -1 refused, 0 none"),
    _("measurement", "drive_state", DriveState, "", "state that each drive reports", *PER_LEG),
    _("measurement", "drive_fault", DriveFault, "", "reason why a drive is in FAULT", *PER_LEG),
    _("measurement", "age", int, "ticks", f"age of the last fresh feedback; {NEVER}: none yet", *PER_LEG),
    _("estimate", "q", float, "m", "leg length, joint centre to joint centre", *PER_LEG),
    _("estimate", "dq", float, "m/s", "leg rate, > 0 extends", *PER_LEG),
    _("measurement", "drive_force", float, "N", "force that the drive reports, > 0 extends", *PER_LEG),
    _("estimate", "p", float, "m", "platform origin in the base frame", *XYZ),
    _("estimate", "R", float, "1", "rotation of the platform: x_base = p + R x_platform", *MATRIX),
    _("estimate", "twist", float, "m/s, rad/s", "velocity of the platform origin, omega; base frame", *TWIST),
    _("reference", "p_d", float, "m", "reference of p", *XYZ),
    _("reference", "R_d", float, "1", "reference of R", *MATRIX),
    _("reference", "twist_d", float, "m/s, rad/s", "reference of twist", *TWIST),
    _("reference", "dtwist_d", float, "m/s^2, rad/s^2", "time derivative of twist_d", *TWIST),
    _("reference", "q_d", float, "m", "reference of the leg length q", *PER_LEG),
    _("reference", "dq_d", float, "m/s", "time derivative of q_d", *PER_LEG),
    _("reference", "ddq_d", float, "m/s^2", "second time derivative of q_d", *PER_LEG),
    _("effort", "tau_law", float, "N", "leg force requested by the law, > 0 extends", *PER_LEG),
    _("effort", "tau_learned", float, "N", "learned leg force, part of the request", *PER_LEG),
    _("verdict", "tau", float, "N", "leg force sent to the drive, > 0 extends", *PER_LEG),
    _("estimate", "wrench", float, "N, N m", "load ON the platform at its origin, base frame", *WRENCH),
    _("estimate", "fk_residual", float, "m", "largest leg residual of forward kinematics"),
    _("estimate", "condition", float, "1", "condition number of J, angles scaled to lengths"),
    _("reference", "reference_time_s", float, "s", "path time along the present motion"),
    _("fusion", "innovation_q", float, "m", "leg length, measured less predicted", *PER_LEG),
    _("fusion", "innovation_tracker", float, "m, rad", "tracker's pose, measured less predicted", *POSE),
    _("fusion", "pose_std", float, "m, rad", "standard deviation of the fused pose, base frame", *POSE),
    _("estimate", "wrench_sensor", float, "N, N m", "last sample of the wrench sensor, base frame", *WRENCH),
    _("verdict", "legs_moved", LegBits, "", "legs that moved on their closed brakes"),
    _("effort", "legs_refused", LegBits, "", "legs without force, as their drives do not obey"),
    _("verdict", "legs_doubted", LegBits, "", "legs with a doubtful encoder, until a reset"),
    _("verdict", "doubt", Doubt, "", "reason for the first doubtful encoder"),
    _("verdict", "doubt_value", float, "m, m/s", "value that gave the doubt: length, or rate for LEAP"),
    _("verdict", "doubt_limit", float, "m, m/s", "limit of doubt_value by noise, forces, disturbance"),
    _("verdict", "encoder_share", float, "1", "gap of length and rate as a share of its limit", *PER_LEG),
    _("verdict", "lyapunov", float, "(m/s^2)^2", "V of the law's error dynamics over all axes"),
    _("verdict", "lyapunov_rate", float, "(m/s^2)^2/s", "change of V since the last tick"),
    _("verdict", "lyapunov_bound", float, "(m/s^2)^2", "the largest V that the law's certificate allows"),
    _("verdict", "lyapunov_share", float, "1", "largest sqrt(V) of an axis as a share of its limit"),
    _("effort", "probe_force", float, "N", "leg force added to test whether the leg moves", *PER_LEG),
    _("sensed", "tracker_pose", float, "m, rad", "the tracker's last pose, base frame", *POSE),
    _("sensed", "tracker_age", float, "s", _AGE),
    _("sensed", "imu", float, "rad/s, m/s^2", "last rate and specific force, platform frame", *MOTION),
    _("sensed", "imu_age", float, "s", _AGE),
    _("sensed", "wrench_sensor_age", float, "s", _AGE),
    _("sensed", "inclination", float, "rad", "last roll and pitch by the inclinometer", "roll", "pitch"),
    _("sensed", "inclination_age", float, "s", _AGE),
    _("sensed", "length_sensor", float, "m", "last leg length by its second encoder", *PER_LEG),
    _("sensed", "length_sensor_age", float, "s", _AGE, *PER_LEG),
    _("sensed", "force_sensor", float, "N", "last leg force by its load cell, > 0 extends", *PER_LEG),
    _("sensed", "force_sensor_age", float, "s", _AGE, *PER_LEG),
    _("estimate", "sensor_share", float, "1", "sensor less legs, share of its limit; inf: silent", *SENSORS),
)
"""Columns of the log, in its order."""
SENSED = tuple(each for each in RECORDED if each.part == "sensed")
"""Last values of the sensors next to the drives, and their ages."""
LATER = RECORDED[-len(SENSED) - 2 : -len(SENSED) - 1], SENSED, RECORDED[-1:]
"""Columns that older logs lack, by the version that added them: nan there, and not compared by a replay."""
WORKING = (
    _("measurement", "length", float, "m", "leg length that the drive last reported", *PER_LEG),
    _("measurement", "rate", float, "m/s", "leg rate that the drive last reported", *PER_LEG),
    _("input", "sensors_rejected", int, "", "number of refused frames of sensors"),
    _("measurement", "blind", int, "", "1: feedback of this tick has an invalid length", *PER_LEG),
    Column("estimate", "J", float, "m, 1", "dq = J twist", tuple(map(str, range(LEGS**2))), (LEGS, LEGS)),
    _("estimate", "length_gap", float, "m", "mean of second encoder less drive's; nan: none", *PER_LEG),
    _("estimate", "length_gap_now", float, "m", "the same of this tick's sample; nan: none", *PER_LEG),
    _("estimate", "tracker_gap", float, "m, rad", "mean of the tracker's pose less that of the legs", *POSE),
    _("estimate", "hop", float, "1", ">= 1: the pose may be of another assembly mode"),
    _("measurement", "counted_age", int, "ticks", "age for safety, 0 where a leg may be lost", *PER_LEG),
    _("fusion", "unseen", int, "", "1 if the length of a leg is an estimate"),
    _("fusion", "fusion_faults", Fault, "", "faults of the fusion filter, bits"),
    _("fusion", "fusion_warnings", Warn, "", "warnings of the fusion filter, bits"),
    _("reference", "t_d", float, "s", "time along the configured trajectory; nan off it"),
    _("effort", "shortfall", float, "N", "last command: sent less requested force", *PER_LEG),
    _("effort", "tau_asked", float, "N", "requested force: law, learned force, ramps", *PER_LEG),
)
"""Columns that exist for one tick only."""
del _
COLUMNS = {column.name: column for column in (*RECORDED, *WORKING)}
INPUT_COLUMNS = tuple(c.name for c in RECORDED if c.part == "input" and not c.name.startswith("frames_"))
"""Columns that replay reads back as TickInput (frames and operator commands have channels of their own)."""
INPUT_ELEMENTS = sum(COLUMNS[name].size for name in INPUT_COLUMNS)
"""Number of elements of INPUT_COLUMNS."""
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
for _unfilled in ("sensor_share", "length_gap", "length_gap_now", "tracker_gap"):
    FIRST[_unfilled] = np.nan
for _sensed in SENSED:
    FIRST[_sensed.name] = np.inf if _sensed.name.endswith("_age") else np.nan
FIRST.flags.writeable = False


def new_record() -> Record:
    """New tick record, a copy of FIRST: the values before the first tick."""
    return np.ndarray((), TICK, FIRST.base.copy())  # type: ignore[union-attr]


def copy_of(record: Record) -> Record:
    """Copy of a tick record, in memory of its own."""
    return np.ndarray((), TICK, record.reshape(1).view(np.float64).copy())


def tick_at(address: int) -> Record:
    """View of the tick record at an address, for Python code."""
    return np.ndarray((), TICK, array_at(address, TICK.itemsize // 8, np.float64))


def row_of(record: Record) -> Record:
    """The recorded columns of a tick record, as a ROW record that shares its memory."""
    return np.ndarray((), ROW, record)


def part(*parts: Part) -> tuple[str, ...]:
    """Names of all columns of some parts, for the argument types of a kernel."""
    return tuple(name for name, column in COLUMNS.items() if column.part in parts)
