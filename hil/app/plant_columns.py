"""The columns that `hil plant` records."""

from typing import Any

from drivers.signals import LEGS, DriveFault, DriveState
from drivers.tick import MATRIX, PER_LEG, TWIST, WRENCH, XYZ, Column
from hil.record.row import Table


def _per_leg(name: str, kind: type[Any], unit: str, meaning: str) -> Column:
    """Return a column with one element a leg."""
    return Column("output", name, kind, unit, meaning, PER_LEG, (LEGS,))


PLANT = Table(
    "/plant",
    (
        Column("output", "tick", int, "", "number of the row"),
        Column("output", "t_ns", int, "ns", "instant of length and rate on the monotonic clock"),
        Column("output", "syncs", int, "", "SYNC frames heard so far"),
        Column("output", "commands", int, "", "valid command frames with a new counter so far"),
        Column("output", "repeated", int, "", "valid command frames without one so far"),
        Column("output", "rejected", int, "", "frames refused so far"),
        _per_leg("drive_state", DriveState, "", "state of each drive"),
        _per_leg("drive_fault", DriveFault, "", "why a drive is in FAULT"),
        _per_leg("length", float, "m", "true leg length, joint centre to joint centre"),
        _per_leg("rate", float, "m/s", "true leg rate"),
        _per_leg("command", float, "N", "last valid command, > 0 extends"),
        _per_leg("force", float, "N", "what the drive puts on the plant, > 0 extends"),
        _per_leg("applied_force", float, "N", "the plant's own answer to that; force where it has none"),
        _per_leg("brake", float, "1", "1 engaged, 0 released"),
        Column("output", "wrench", float, "N, N m", "load ON the platform", WRENCH, (6,)),
        Column("output", "p", float, "m", "platform origin in the base frame; nan: unknown", XYZ, (3,)),
        Column("output", "R", float, "1", "x_base = p + R x_platform; nan: unknown", MATRIX, (3, 3)),
        Column(
            "output", "twist", float, "m/s, rad/s", "velocity of the origin; omega; base frame", TWIST, (6,)
        ),
    ),
)
"""The truth that the controller does not know.

One row for every SYNC, for every other frame that the drives send, and every few milliseconds while
something moves and nobody asks.
"""
