"""Reader of a log: ticks in order, columns, CAN frames, events."""

from __future__ import annotations

import os
from collections.abc import Iterator
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from drivers.errors import LogError
from drivers.tick_columns import RECORDED
from hil.record.entries import Command, Event, LoggedFrame, Tick, assemble, logged
from hil.record.layout import ITEM
from hil.record.log_file import LogFile
from hil.record.schema import CAN_TOPIC, SUMMARY
from hil.record.selection import together

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["Event", "Log", "LogStatistics", "LoggedFrame", "Tick"]

_SETTLED_NS = 1_000_000_000
"""A frame is yielded after a frame that is this much later, ns, has been read."""

PLANT_TOPIC = "/plant"
"""Topic of a plant's rows."""


def plant_log_beside(path: Path) -> Path:
    """Path of the plant's log that `hil run --plant` writes next to the controller's log `path`."""
    return path.with_name(f"{path.stem}-plant{path.suffix}")


class LogStatistics(NamedTuple):
    """Size and duration of a log, and how it was closed."""

    ticks: int
    """Number of rows: ticks of the controller, or steps of the plant in its log."""
    frames: int
    """CAN frames, received and sent."""
    duration_s: float
    """Time from the first message to the last, s."""
    dropped: int
    """Ticks dropped by the recorder."""
    closed: str
    """How the log was closed: `clean`, `producer died`, `salvaged`, `cut` (truncated), or `unknown`."""


class Log(LogFile):
    """Log of a run: ``Log("run.mcap").frame()``.

    A truncated log is read up to its last complete tick; `cut` states the reason. Only metadata and
    attachments stay in memory; each call reads the file again.

    path: MCAP file of `hil run`, `hil sim` or `hil plant`.
    plant: the plant's log of the same run; by default the file that `hil run --plant` writes next to it.

    Raises LogError: no such file, not MCAP, damaged, not written by this product, or truncated within its
    first bytes.
    """

    def __init__(self, path: str | os.PathLike[str], *, plant: str | os.PathLike[str] | None = None) -> None:
        super().__init__(path)
        self._plant_path = plant_log_beside(self.path) if plant is None else Path(plant)

    def __repr__(self) -> str:
        return f"Log({str(self.path)!r})"

    @classmethod
    def open(cls, path: str | os.PathLike[str]) -> Log:
        """Open a complete log: reads all of it once and compares its checksums.

        Raises LogError: as the class; also for a truncated log, or if a checksum differs.
        """
        log = cls(path)
        if log.cut:
            raise LogError(f"{path}: {log.cut}")
        _ = log.summary
        return log

    @property
    def plant(self) -> Log:
        """Log of the plant in the same run.

        Raises LogError: the file is missing, unreadable, or not a plant's log.
        """
        if not self._plant_path.exists():
            raise LogError(
                f"{self.path}: {self._plant_path}, the plant's log, does not exist; `hil run --plant` and "
                "`hil sim --plant-log` write it: give its path as Log(path, plant=FILE)"
            )
        log = Log(self._plant_path)
        if log.topic != PLANT_TOPIC:
            raise LogError(f"{log.path}: topic {log.topic}, allowed: a log of a plant, {PLANT_TOPIC}")
        return log

    @cached_property
    def summary(self) -> LogStatistics:
        """Counts over the whole log; reads all of it once and compares every checksum.

        Raises LogError: the file is damaged.
        """
        ticks, frames, times, end = 0, 0, np.zeros(0, np.int64), self.metadata.get(SUMMARY, {})
        for (table,) in self._decoded(lambda _, table: table):
            ticks += len(self._messages_of(table, self.topic))
            frames += len(self._messages_of(table, CAN_TOPIC))
            times = np.sort(np.append(times, table.log_time))[[0, -1][: len(table.log_time) + len(times)]]
        dropped = end.get("dropped", "")
        return LogStatistics(
            ticks,
            frames,
            duration_s=float(np.ptp(times)) * 1e-9 if len(times) else 0.0,
            dropped=int(dropped) if dropped.isdecimal() and len(dropped) < 19 else 0,
            closed="cut" if self.cut else end.get("closed", "unknown"),
        )

    def figures(self) -> dict[str, Any]:
        """Figures of the run as in its summary: errors, forces, wake-up times, faults.

        Raises LogError: a plant's log, or columns of another version.
        """
        there = {c.name: (c.kind, c.shape) for c in self.columns}
        other = [c.name for c in RECORDED if there.get(c.name) != (c.kind, c.shape)]
        if other:
            raise LogError(f"{self.path}: no figures: columns {', '.join(other[:3])} are missing or differ")
        from hil.record.figures import figures  # noqa: PLC0415 - compiled mathematics

        return figures(self.rows())

    def frame(
        self, *names: str, start_s: float | None = None, stop_s: float | None = None, numbers: bool = False
    ) -> pd.DataFrame:
        """Columns as a pandas DataFrame: one row per tick, one column per component.

        names: columns (`tau`) or components (`tau.leg_3`, `p.z`); by default all of this log. Columns of the
        plant's log (`plant.p`, or `plant` for all) are aligned to the ticks: the state at the SYNC of the
        tick, within half an internal step of the plant (`plant.t_ns` is the exact time); nan where the plant
        has no row for that SYNC.
        start_s, stop_s: first and last time, s from the first row.
        numbers: keep the numbers of enumerations and flags; by default they are categories by name, flags
        joined by `|`.

        The index `t_s` is the time from the first row, s. `attrs` holds `units` and `meanings` by column,
        `epoch_ns` (UTC of `t_ns` = 0) and `log` (the file).

        Raises LogError: unknown column, pandas is not installed, or the plant's log is missing or of another
        run.
        """
        from hil.record.data_frame import data_frame  # noqa: PLC0415 - pandas: an extra

        return data_frame(self, lambda: self.plant, names, start_s, stop_s, numbers=numbers)

    def events(self) -> list[Event]:
        """All events of the run, in the order of the file."""
        return [event for (events,) in self._decoded(self._events_in) for event in events]

    def can_frames(self) -> Iterator[LoggedFrame]:
        """CAN frames in order of time, read block by block.

        Frames with equal times keep the order of the log. A frame that the controller read more than a second
        after its reception may follow later frames.

        Raises LogError: the file is damaged.
        """
        pending = np.zeros(0, ITEM)
        for (items,) in self._decoded(self._frames_in):
            pending = together((pending, items))
            if not len(pending):
                continue
            pending = pending.take(np.argsort(pending["frame"]["t_ns"], kind="stable"))
            t_ns = pending["frame"]["t_ns"]
            settled = int(np.searchsorted(t_ns, t_ns[-1] - _SETTLED_NS))
            yield from logged(pending[:settled])
            pending = pending[settled:]
        yield from logged(pending)

    def ticks(self) -> Iterator[Tick]:
        """Yield all ticks in order; the file is read block by block, so memory stays small.

        Raises LogError: the file is damaged.
        """
        rows, items = np.zeros(0, self.dtype), np.zeros(0, ITEM)
        commands: list[Command] = []
        for more, frames, said in self._decoded(self._rows_in, self._frames_in, self._commands_in):
            rows, items, commands = together((rows, more)), together((items, frames)), commands + said
            yield from assemble(rows[:-1], items, commands)
            rows = rows[-1:]  # what belongs to it may go on in the next chunk
            items = items[np.isin(items["tick"], rows["tick"])]
            commands = [each for each in commands if each.tick in rows["tick"]]
        yield from assemble(rows, items, commands)
