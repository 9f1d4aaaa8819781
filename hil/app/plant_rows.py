"""The rows of the plant's log in real time: what drives are asked is answered first."""

from collections.abc import Callable
from typing import Any

import numpy as np

from drivers.arrays import Rows
from drivers.frame_array import FRAME
from drivers.signals import DriveState
from hil.app.plant_columns import PLANT
from plant_fmu.drives.drive import Snapshot
from plant_fmu.drives.nodes import Nodes

SILENT_NS = 5_000_000
"""How often a moving platform is recorded when nobody asks, and one that has to answer all the time."""
REST_RATE_m_s = 1e-3
"""A leg slower than this is at rest."""
_ROW = PLANT.dtype
Row = np.ndarray[Any, np.dtype[np.void]]
"""One row of PLANT."""


def plant_row(number: int, s: Snapshot) -> Row:
    """Return one row of PLANT."""
    row = np.zeros((), _ROW)
    truth = s.truth
    row[()] = (
        number, s.t_ns, s.syncs, s.commands, s.repeated, s.rejected, s.state, s.fault, s.length, s.rate,
        s.command, s.force, s.applied, s.brake, s.wrench,
        *((np.nan, np.nan, np.nan) if truth is None else (truth.p, truth.R, truth.twist)),
    )  # fmt: skip
    return row


def at_rest(s: Snapshot) -> bool:
    """Tell whether no drive is powered and no leg moves."""
    powered = np.isin(s.state, (DriveState.READY, DriveState.RUN)).any()
    return not powered and float(np.abs(s.rate).max()) < REST_RATE_m_s


class PlantRows:
    """Rows of the plant's log: one when drives were heard or have spoken, and now and then while legs move.

    Mutable state: the last snapshot, the number of rows, the frames since then, whether legs move, and since
    when a row is due.
    """

    def __init__(self, record: Callable[[Row, Rows, Rows], Any] | None, nodes: Nodes) -> None:
        """Take what records a row with the frames heard and sent; None records nothing."""
        self._record, self._nodes = record, nodes
        self._last = nodes.snapshot()
        self._number, self._moving = 0, False
        self._heard, self._sent = bytearray(), bytearray()
        self._due_ns: int | None = None

    def take(self, heard: Rows, sent: Rows, now_ns: int) -> None:
        """Note what the drives heard and sent until now."""
        if self._record is None:
            return
        self._heard += heard.tobytes()
        self._sent += sent.tobytes()
        spoke = len(sent) > 0 or self._nodes.syncs != self._last.syncs
        if self._due_ns is None and (spoke or (self._moving and now_ns - self._last.t_ns >= SILENT_NS)):
            self._due_ns = now_ns

    def write(self, now_ns: int, *, answered: bool = True) -> None:
        """Write the row that is due, if any: once all is `answered`, after SILENT_NS in any case."""
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
