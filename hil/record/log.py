"""A recorded run: its ticks in their order, its columns, frames and events."""

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
from hil.record.log_file import LogFile
from hil.record.schema import CAN_TOPIC, SUMMARY
from hil.record.selection import together
from hil.record.unpack import ITEM

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["Event", "Log", "LogStatistics", "LoggedFrame", "Tick"]

_SETTLED_NS = 1_000_000_000
"""A frame is handed out when one so much later has been read."""

PLANT_TOPIC = "/plant"
"""Topic of a plant's rows."""


def plant_log_beside(path: Path) -> Path:
    """Return where the plant's log of a run is that records to `path`, whatever that ends with."""
    return path.with_name(f"{path.stem}-plant{path.suffix}")


class LogStatistics(NamedTuple):
    """What is in a log."""

    ticks: int
    """Rows; of a plant's log, those of the plant."""
    frames: int
    """CAN frames received and sent."""
    duration_s: float
    """From the first message to the last, s."""
    dropped: int
    """Ticks that the recorder had to drop."""
    closed: str
    """`clean`, `producer died`, `salvaged`, `cut`, or `unknown`."""


class Log(LogFile):
    """A run's log: ``Log("run.mcap").frame()``.

    A log that is cut is read as far as it goes, and `cut` says so. Nothing but metadata and attachments stays
    in memory; each call reads the file again.

    path: the MCAP file of `hil run`, `hil sim` or `hil plant`.
    plant: the plant's log of the same run; without, the one that `hil run --plant` writes beside it.

    Raises LogError: no such file, no MCAP, damaged, not written by this product, or cut within its first
    bytes.
    """

    def __init__(self, path: str | os.PathLike[str], *, plant: str | os.PathLike[str] | None = None) -> None:
        super().__init__(path)
        self._plant_path = plant_log_beside(self.path) if plant is None else Path(plant)

    def __repr__(self) -> str:
        return f"Log({str(self.path)!r})"

    @classmethod
    def open(cls, path: str | os.PathLike[str]) -> Log:
        """Open a log that has to be whole: all of it is read once, and its checksums compared.

        Raises LogError: as the class; and where it is cut, or its checksum differs.
        """
        log = cls(path)
        if log.cut:
            raise LogError(f"{path}: {log.cut}")
        _ = log.summary
        return log

    @property
    def plant(self) -> Log:
        """The plant's log of the same run.

        Raises LogError: there is none, it cannot be read, or it is none of a plant.
        """
        if not self._plant_path.exists():
            raise LogError(
                f"{self.path}: {self._plant_path}, the plant's log, does not exist; `hil run --plant` and "
                "`hil sim --plant-log` write it: name it with Log(path, plant=FILE)"
            )
        log = Log(self._plant_path)
        if log.topic != PLANT_TOPIC:
            raise LogError(f"{log.path}: holds {log.topic}, allowed: a log of a plant, {PLANT_TOPIC}")
        return log

    @cached_property
    def summary(self) -> LogStatistics:
        """Counts of the whole log; all of it is read once for them, and every checksum compared.

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
        """Return the run's figures as its summary has them: errors, forces, wake-ups, faults.

        Raises LogError: the log is a plant's, or its columns are those of another version.
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
        """Return columns as a pandas DataFrame, one row a tick, one column a component.

        names: columns (`tau`) or components (`tau.leg_3`, `p.z`); all of the log where none is given. Those
        of the plant's log (`plant.p`, or `plant` for all) are aligned to the ticks: what was true at the
        tick's SYNC, to half an internal step of the plant (`plant.t_ns` is the instant), nan where the plant
        has no row of that SYNC.
        start_s, stop_s: first and last time, s from the first row.
        numbers: leave the numbers of enumerations and flags; else they are categories by name, flags joined
        by `|`.

        The index of the result, `t_s`, is the time from the first row in s. `attrs` has `units` and
        `meanings` by column, `epoch_ns`, the UTC of `t_ns` = 0, and `log`, the file.

        Raises LogError: no such column, pandas is not installed, or the plant's log is missing or of another
        run.
        """
        from hil.record.data_frame import data_frame  # noqa: PLC0415 - pandas: an extra

        return data_frame(self, lambda: self.plant, names, start_s, stop_s, numbers=numbers)

    def events(self) -> list[Event]:
        """Return all events, in the order of the file."""
        return [event for (events,) in self._decoded(self._events_in) for event in events]

    def can_frames(self) -> Iterator[LoggedFrame]:
        """Yield the CAN frames in the order of their times, reading as it goes.

        Frames of one time stand in the order of the log. One that was consumed more than a second after it
        was received may come after later ones.

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
        """Yield the ticks in their order, reading as it goes.

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
