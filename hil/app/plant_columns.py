"""The columns that `hil plant` records."""

from functools import partial

from drivers.signals import DriveFault, DriveState
from drivers.tick_columns import MATRIX, PER_LEG, TWIST, WRENCH, XYZ, column
from hil.record.row import Table

own = partial(column, "output")
PLANT = Table(
    "/plant",
    (
        own("tick", int, "", "number of the row"),
        own("t_ns", int, "ns", "instant of length and rate on the monotonic clock"),
        own("syncs", int, "", "SYNC frames, of polled drives the polls of each, heard so far on all buses"),
        own("commands", int, "", "valid command frames with a new counter so far"),
        own("repeated", int, "", "valid command frames without one so far"),
        own("rejected", int, "", "frames refused so far"),
        own("drive_state", DriveState, "", "state of each drive", *PER_LEG),
        own("drive_fault", DriveFault, "", "why a drive is in FAULT", *PER_LEG),
        own("length", float, "m", "true leg length, joint centre to joint centre", *PER_LEG),
        own("rate", float, "m/s", "true leg rate", *PER_LEG),
        own("command", float, "N", "last valid command, > 0 extends", *PER_LEG),
        own("force", float, "N", "what the drive puts on the plant, > 0 extends", *PER_LEG),
        own("applied_force", float, "N", "the plant's own answer to that; force where it has none", *PER_LEG),
        own("brake", float, "1", "1 engaged, 0 released", *PER_LEG),
        own("wrench", float, "N, N m", "load ON the platform", *WRENCH),
        own("p", float, "m", "platform origin in the base frame; nan: unknown", *XYZ),
        own("R", float, "1", "x_base = p + R x_platform; nan: unknown", *MATRIX),
        own("twist", float, "m/s, rad/s", "velocity of the origin; omega; base frame", *TWIST),
    ),
)
"""The truth that the controller does not know.

One row for every SYNC, for every other frame that the drives send (for several of them where they come so
fast that there is only time to answer), and every few milliseconds while something moves and nobody asks.
"""
