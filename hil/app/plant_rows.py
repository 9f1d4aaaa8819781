"""Columns of the plant's log, and the writer of its rows in real time, after the drives have answered."""

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from drivers.arrays import Rows
from drivers.frame_array import FRAME
from drivers.signals import DriveFault, DriveState
from drivers.tick_columns import MATRIX, PER_LEG, TWIST, WRENCH, XYZ, column
from hil.record.row import Table
from plant_fmu.drives.drive import Snapshot
from plant_fmu.drives.nodes import Nodes
from plant_fmu.plant import Plant

if TYPE_CHECKING:
    from hil.record import Recording

own = partial(column, "output")
PLANT = Table(
    "/plant",
    (
        own("tick", int, "", "number of the row"),
        own("t_ns", int, "ns", "instant of length and rate on the monotonic clock"),
        own("syncs", int, "", "SYNC frames, or polls of each polled drive, received so far on all buses"),
        own("commands", int, "", "valid command frames with a new counter so far"),
        own("repeated", int, "", "valid command frames without one so far"),
        own("rejected", int, "", "frames refused so far"),
        own("drive_state", DriveState, "", "state of each drive", *PER_LEG),
        own("drive_fault", DriveFault, "", "why a drive is in FAULT", *PER_LEG),
        own("length", float, "m", "true leg length, joint centre to joint centre", *PER_LEG),
        own("rate", float, "m/s", "true leg rate", *PER_LEG),
        own("command", float, "N", "last valid command, > 0 extends", *PER_LEG),
        own("force", float, "N", "force of the drive on the plant, > 0 extends", *PER_LEG),
        own("applied_force", float, "N", "force that the plant reports; else `force`", *PER_LEG),
        own("brake", float, "1", "1 engaged, 0 released", *PER_LEG),
        own("wrench", float, "N, N m", "load ON the platform", *WRENCH),
        own("p", float, "m", "platform origin in the base frame; nan: unknown", *XYZ),
        own("R", float, "1", "x_base = p + R x_platform; nan: unknown", *MATRIX),
        own("twist", float, "m/s, rad/s", "velocity of the origin; omega; base frame", *TWIST),
    ),
)
"""True state of the plant, unknown to the controller.

One row for every SYNC and every other frame that the drives send. Frames in quick succession share a row.
Without requests there is a row every few milliseconds while something moves.
"""
SILENT_NS = 5_000_000
"""Period of rows while the platform moves without requests; longest delay of a row while drives answer."""
REST_RATE_m_s = 1e-3
"""Leg speed below which a leg is at rest."""
_ROW = PLANT.dtype
Row = np.ndarray[Any, np.dtype[np.void]]
"""One row of PLANT."""


def plant_row(number: int, s: Snapshot) -> Row:
    """Row `number` of the plant's log, from a snapshot of the plant."""
    row = np.zeros((), _ROW)
    truth = s.truth
    row[()] = (
        number, s.t_ns, s.syncs, s.commands, s.repeated, s.rejected, s.state, s.fault, s.length, s.rate,
        s.command, s.force, s.applied, s.brake, s.wrench,
        *((np.nan, np.nan, np.nan) if truth is None else (truth.p, truth.R, truth.twist)),
    )  # fmt: skip
    return row


def plant_warnings(plant: Plant, recording: "Recording | None", t_ns: int) -> dict[str, list[str]]:
    """Write the warnings that a plant reported into its log; return them for the summary, empty without."""
    notes = plant.notes()
    if recording is not None:
        for note in notes:
            recording.event(t_ns, "warning", note)
    return {"plant_warnings": notes} if notes else {}


def at_rest(s: Snapshot) -> bool:
    """True if no drive is powered and no leg moves."""
    powered = np.isin(s.state, (DriveState.READY, DriveState.RUN)).any()
    return not powered and float(np.abs(s.rate).max()) < REST_RATE_m_s


class PlantRows:
    """Writes the plant's log: a row per exchange of frames, and periodic rows while legs move.

    Mutable state: the last snapshot, the number of rows, the frames since then, whether legs move, and the
    time at which a row became due.
    """

    def __init__(self, record: Callable[[Row, Rows, Rows], Any] | None, nodes: Nodes) -> None:
        """record: called with a row, the frames received and the frames sent; None records nothing."""
        self._record, self._nodes = record, nodes
        self._last = nodes.snapshot()
        self._number, self._moving = 0, False
        self._heard, self._sent = bytearray(), bytearray()
        self._due_ns: int | None = None

    def take(self, heard: Rows, sent: Rows, now_ns: int) -> None:
        """Store the frames that the drives received and sent until now_ns, for the next row."""
        if self._record is None:
            return
        self._heard += heard.tobytes()
        self._sent += sent.tobytes()
        spoke = len(sent) > 0 or self._nodes.syncs != self._last.syncs
        if self._due_ns is None and (spoke or (self._moving and now_ns - self._last.t_ns >= SILENT_NS)):
            self._due_ns = now_ns

    def write(self, now_ns: int, *, answered: bool = True) -> None:
        """Write the row that is due, if any: once all is `answered`, at the latest after SILENT_NS."""
        if self._record is None or self._due_ns is None:
            return
        if answered or now_ns - self._due_ns >= SILENT_NS:
            self._last, self._due_ns = self._nodes.snapshot(), None
            self._moving = not at_rest(self._last)
            heard, sent = np.frombuffer(self._heard, FRAME), np.frombuffer(self._sent, FRAME)
            sent["t_ns"] = self._last.t_ns
            self._record(plant_row(self._number, self._last), heard, sent)
            self._number += 1
            self._heard, self._sent = bytearray(), bytearray()
