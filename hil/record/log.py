"""A recorded run: its ticks in their order, its columns, frames and events."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from functools import cached_property
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from drivers.arrays import Rows
from drivers.errors import LogError
from drivers.tick_columns import RECORDED
from hil.record.decode import ITEM
from hil.record.entries import Commands, Event, LoggedFrame, Tick, assemble, logged
from hil.record.log_file import LogFile
from hil.record.mcap_read import MessageTable, read_summary
from hil.record.row import Table
from hil.record.schema import CAN_TOPIC, EVENTS_TOPIC, LEVEL_NAMES, OPERATOR_TOPIC, SUMMARY
from hil.record.selection import Selection, together
from hil.signals import NUMBERS, Operator

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["Event", "Log", "LogStatistics", "LoggedFrame", "Tick"]

_BATCH, _LOOKAHEAD = 256, 64
"""Ticks read before any is handed out, and how far other writers may have moved a message."""
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

    Parameters
    ----------
    path
        The MCAP file of `hil run`, `hil sim` or `hil plant`.
    plant
        The plant's log of the same run; without, the one that `hil run --plant` writes beside it.

    Raises
    ------
    LogError
        No such file, no MCAP, damaged, not written by this product, or cut within its first bytes.

    """

    def __init__(self, path: str | os.PathLike[str], *, plant: str | os.PathLike[str] | None = None) -> None:
        super().__init__(path)
        self._plant_path = plant_log_beside(self.path) if plant is None else Path(plant)

    def __repr__(self) -> str:
        return f"Log({str(self.path)!r})"

    @classmethod
    def open(cls, path: str | os.PathLike[str]) -> Log:
        """Open a log that has to be whole: all of it is read once, and its checksum compared.

        Raises
        ------
        LogError
            As the class; and where it is cut, or its checksum differs.

        """
        log = cls(path)
        if log.cut:
            raise LogError(f"{path}: {log.cut}")
        log.verify()
        return log

    @property
    def dtype(self) -> np.dtype[np.void]:
        """Type of the rows."""
        return Table(self.topic, self.columns).dtype

    def _rows_of(self, data: bytes, table: MessageTable) -> Rows:
        """Return the rows in a buffer, nan in columns that the log lacks."""
        rows = self._decoder.rows(data, table)
        if rows.dtype.itemsize == self.dtype.itemsize:
            return rows
        whole = np.full((len(rows), self.dtype.itemsize // 8), np.nan)
        whole[:, : rows.dtype.itemsize // 8] = rows.view(np.float64).reshape(
            len(rows), rows.dtype.itemsize // 8
        )
        return whole.view(self.dtype)[:, 0]

    @cached_property
    def origin_ns(self) -> int:
        """Where the time `t_s` of a frame begins, the `t_ns` of the first row; 0 without a row."""
        return next((int(block["t_ns"][0]) for block in self.blocks("t_ns")), 0)

    @property
    def plant(self) -> Log:
        """The plant's log of the same run.

        Raises
        ------
        LogError
            There is none, it cannot be read, or it is none of a plant.

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

    @property
    def summary(self) -> LogStatistics:
        """What is in the log, from its index, or counted where it is cut.

        Raises
        ------
        LogError
            The index is damaged.

        """
        if self.cut:
            return self._counted()
        with self._reading():
            statistics, topics = read_summary(self.path)
        counts = {topic: statistics.channel_message_counts.get(i, 0) for i, topic in topics.items()}
        closing = self.metadata.get(SUMMARY, {})
        dropped = closing.get("dropped", "0")
        return LogStatistics(
            ticks=counts.get(self.topic, 0),
            frames=counts.get(CAN_TOPIC, 0),
            duration_s=(statistics.message_end_time - statistics.message_start_time) * 1e-9,
            dropped=int(dropped) if dropped.isdecimal() and len(dropped) < 19 else 0,
            closed=closing.get("closed", "unknown"),
        )

    def _counted(self) -> LogStatistics:
        ticks = frames = 0
        first, last = 1 << 64, 0
        for _, table in self._buffers():
            ticks += len(self._decoder.messages_of(table, self.topic))
            frames += len(self._decoder.messages_of(table, CAN_TOPIC))
            if len(table.log_time):
                first, last = min(first, int(table.log_time.min())), max(last, int(table.log_time.max()))
        return LogStatistics(ticks, frames, max(last - first, 0) * 1e-9, 0, "cut")

    def figures(self) -> dict[str, Any]:
        """Return the run's figures as its summary has them: errors, forces, wake-ups, faults.

        Raises
        ------
        LogError
            The log is a plant's, or its columns are those of another version.

        """
        there = {c.name: (c.kind, c.shape) for c in self.columns}
        other = [c.name for c in RECORDED if there.get(c.name) != (c.kind, c.shape)]
        if other:
            raise LogError(f"{self.path}: no figures: columns {', '.join(other[:3])} are missing or differ")
        from hil.record.figures import figures  # noqa: PLC0415 - compiled mathematics

        return figures(self.rows())

    def frame(
        self,
        *names: str,
        start_s: float | None = None,
        stop_s: float | None = None,
        numbers: bool = False,
    ) -> pd.DataFrame:
        """Return columns as a pandas DataFrame, one row a tick, one column a component.

        Parameters
        ----------
        names
            Columns (`tau`) or components (`tau.leg_3`, `p.z`); all of the log where none is given. Those of
            the plant's log (`plant.p`, or `plant` for all) are aligned to the ticks: what was true at the
            tick's SYNC, to half an internal step of the plant (`plant.t_ns` is the instant), nan where the
            plant has no row of that SYNC.
        start_s, stop_s
            First and last time, s from the first row.
        numbers
            Leave the numbers of enumerations and flags; else they are categories by name, flags joined by
            `|`.

        Returns
        -------
        pandas.DataFrame
            Its index `t_s` is the time from the first row in s. `attrs` has `units` and `meanings` by column,
            `epoch_ns`, the UTC of `t_ns` = 0, and `log`, the file.

        Raises
        ------
        LogError
            No such column, pandas is not installed, or the plant's log is missing or of another run.

        """
        from hil.record.data_frame import data_frame  # noqa: PLC0415 - pandas: an extra

        return data_frame(self, names, start_s, stop_s, numbers=numbers)

    def rows(self, *names: str, start_s: float | None = None, stop_s: float | None = None) -> Rows:
        """Return rows in tick order: a structured array (n,), ``rows["tau"]`` is (n, 6).

        Parameters
        ----------
        names
            Columns to read; all where none is given.
        start_s, stop_s
            First and last time, s from the first row.

        Raises
        ------
        LogError
            No such column, or the file is damaged.

        """
        selection = self._selection(names, start_s, stop_s)
        parts, ticks = [np.zeros(0, selection.dtype)], [np.zeros(0, np.int64)]
        for data, table in self._buffers():
            part = selection.within(self._rows_of(data, table))
            ticks.append(part["tick"].copy())  # a view would keep the whole rows
            parts.append(selection.of_rows(part))
        rows, order = together(parts), np.concatenate(ticks)
        if (np.diff(order) >= 0).all():
            return rows
        return rows.take(np.argsort(order, kind="stable"))

    def blocks(
        self, *names: str, start_s: float | None = None, stop_s: float | None = None
    ) -> Iterator[Rows]:
        """Yield what `rows` returns in pieces, reading as it goes: for logs that do not fit into memory.

        Raises
        ------
        LogError
            As `rows`; or another program has moved rows too far from their place.

        """
        selection = self._selection(names, start_s, stop_s)
        for ready, _ in self._in_order():
            within = selection.within(ready)
            if len(within):
                yield selection.of_rows(within)

    def _selection(self, names: Sequence[str], start_s: float | None, stop_s: float | None) -> Selection:
        selection = Selection.of(self.columns, names, str(self.path))
        if start_s is not None:
            selection = selection._replace(first_ns=self.origin_ns + start_s * 1e9)
        if stop_s is not None:
            selection = selection._replace(last_ns=self.origin_ns + stop_s * 1e9)
        return selection

    def events(self) -> list[Event]:
        """Return all events, in the order of the file."""
        found = []
        for data, table in self._buffers():
            for message in self._decoder.messages(data, table, EVENTS_TOPIC):
                t_ns = message.timestamp.seconds * 1_000_000_000 + message.timestamp.nanos - self.epoch_ns
                found.append(Event(t_ns, LEVEL_NAMES.get(message.level, "info"), message.message))
        return found

    def can_frames(self) -> Iterator[LoggedFrame]:
        """Yield the CAN frames in the order of their times, reading as it goes.

        Frames of one time stand in the order of the log. One that was consumed more than a second after it
        was received may come after later ones.

        Raises
        ------
        LogError
            The file is damaged.

        """
        pending = np.zeros(0, ITEM)
        for data, table in self._buffers():
            pending = together((pending, self._decoder.frames(data, table)))
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

        Raises
        ------
        LogError
            The file is damaged, or another program has moved messages too far from their tick.

        """
        commands: Commands = {}
        for rows, frames in self._in_order(commands):
            yield from assemble(rows, frames, commands)

    def _in_order(self, commands: Commands | None = None) -> Iterator[tuple[Rows, Rows]]:
        """Yield rows in tick order, reading as it goes; with `commands`, which it fills, their frames, too.

        Raises LogError for what belongs to ticks that were already handed out.
        """
        rows, items, done = np.zeros(0, self.dtype), np.zeros(0, ITEM), -1
        for buffer in chain(self._buffers(), (None,)):
            if buffer is not None:
                rows = together((rows, self._rows_of(*buffer)))
                if commands is not None:
                    items = together((items, self._decoder.frames(*buffer)))
                    self._read_commands(*buffer, commands)
                if len(rows) < _BATCH:
                    continue
            ticks = np.concatenate((rows["tick"], items["tick"]))
            if len(ticks) and int(ticks.min()) <= done:
                raise LogError(f"{self.path}: messages stand more than {_LOOKAHEAD} ticks out of order")
            order = rows["tick"]
            if (order[1:] < order[:-1]).any():
                rows = rows.take(np.argsort(order, kind="stable"))
            settled = len(rows) if buffer is None else len(rows) - _LOOKAHEAD
            ready, rows = rows[:settled], rows[settled:]
            done = int(ready["tick"][-1]) if len(ready) else done
            mine = items["tick"] <= done
            yield ready, items.compress(mine)
            items = items.compress(~mine)

    def _read_commands(self, data: bytes, table: MessageTable, commands: Commands) -> None:
        """Add the operator's commands in a buffer to those found before."""
        for message in self._decoder.messages(data, table, OPERATOR_TOPIC):
            with self._decoder.understood(OPERATOR_TOPIC):
                tick, command = int(message.tick), Operator(message.command)
                numbers = tuple(map(float, message.setpoint))
                commands.setdefault(tick, []).append((int(message.index), command, numbers))
            wanted = NUMBERS.get(command)
            if wanted is not None and len(numbers) != wanted:
                raise LogError(
                    f"{self.path}: the operator's command of tick {tick} has {len(numbers)} numbers, "
                    f"allowed: {wanted}"
                )
