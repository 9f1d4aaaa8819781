"""Producer's end of a recording, called by the loop once per tick.

`tick` only writes to shared memory: no file, no lock, no system call. In real time it never waits: if the
ring is full, the tick is dropped and counted. In lockstep it waits for room.
"""

import contextlib
import json
import os
import subprocess
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np

from drivers.arrays import Ints, Rows
from drivers.clock import MONOTONIC, Clock
from drivers.errors import LogError
from drivers.frame_array import FRAME, frame_bytes, received_array, sent_array, sent_at
from drivers.protocol import Frame, Received
from hil.record.child import RecorderEnd
from hil.record.environment import environment, product_version, scheduling
from hil.record.layout import MAX_DATA
from hil.record.ring import (
    DROPPED,
    EVENT,
    EVENTS,
    OPERATOR,
    READ,
    READ_ITEMS,
    WRITTEN,
    Ring,
    fence,
    pack_numbers,
)
from hil.record.row import TICKS, Table, describe
from hil.record.schema import CONFIGURATION, LEVELS
from hil.signals import Operator, Order, SetPoint

LOCKSTEP_EPOCH_NS = 946_684_800_000_000_000
"""2000-01-01T00:00:00Z, the UTC of t_ns = 0 in lockstep."""
_SETPOINT = int(Operator.SETPOINT)
_START_S = 20.0
VIEW_EVERY = 33
"""Ticks between two messages of `/scene` and `/tf`."""


class RecorderEndedError(LogError):
    """The recorder ended during a simulation: its disk is full, or it was killed."""


class Scene(NamedTuple):
    """Joint positions for the 3D view in the log."""

    base_joints: Sequence[Sequence[float]]
    """(6, 3) m, base frame."""
    platform_joints: Sequence[Sequence[float]]
    """(6, 3) m, platform frame."""
    every: int = VIEW_EVERY


class Live(NamedTuple):
    """Outputs of a run that can be seen while it is recorded."""

    status: bool = False
    """True: status line on standard error, for rows of TICKS only."""
    reference_s: float | None = None
    """Length of the reference, s, for the progress in the status line."""
    websocket: tuple[str, int] | None = None
    """Host and port for viewers; in real time only."""


class LogSummary(NamedTuple):
    """What a log holds after the run, what is missing, and why."""

    path: Path
    ticks: int
    """Ticks in the log."""
    messages: int
    dropped: int
    """Ticks dropped because the ring was full."""
    lost: int
    """Ticks that entered the ring but not the log."""
    size_bytes: int
    recorder_cpu_s: float
    """Processor time of the recorder, including its start."""
    complete: bool
    """True if the log was closed and holds every tick."""
    error: str
    """Error of the recorder, or empty."""
    gave_up: bool
    """True if the recorder itself could not write any more: the disk is full, or fails."""


class Recording(contextlib.AbstractContextManager["Recording"]):
    """A log being written by a recorder process.

    State: counters of the ring's write side, the final reply of the recorder.
    """

    def __init__(self, ring: Ring, end: RecorderEnd, path: Path, *, lockstep: bool) -> None:
        self.path = path
        self._ring = ring
        self._end = end
        self._lockstep = lockstep
        self._counters = ring.counters
        self._items = 0
        self.ticks = 0
        """Ticks that entered the ring."""
        self.dropped = 0
        """Ticks dropped because the ring was full."""
        self._summary: LogSummary | None = None
        self._reply: Mapping[str, Any] | None = None

    @property
    def process(self) -> subprocess.Popen[bytes]:
        """Recorder's process, on Linux."""
        assert self._end.process is not None
        return self._end.process

    @classmethod
    def start(
        cls,
        path: str | os.PathLike[str],
        *,
        configuration: str,
        table: Table = TICKS,
        attachments: Sequence[tuple[str, bytes]] = (),
        metadata: Mapping[str, object] | None = None,
        scene: Scene | None = None,
        can_channel: str | Sequence[str] = "can0",
        lockstep: bool = False,
        ring_ticks: int = 8192,
        live: Live = Live(),  # noqa: B008 - frozen
        clock: Clock = MONOTONIC,
        mirror: tuple[Path, Mapping[str, object]] | None = None,
    ) -> Self:
        """Start a recorder process and open the log `path`, which is never overwritten.

        Call it before the process is pinned or made real-time: the recorder inherits the affinity.

        configuration, attachments : text of the configuration and further (name, content), all attached.
        metadata : content of the metadata record `hil`, as JSON where it is not text.
        can_channel : name of the bus in the frames, or names of several in their order.
        lockstep : simulated time: `tick` waits while the ring of `ring_ticks` is full; fixed epoch,
        reproducible messages. Else `clock` gives the times.
        mirror : file for the newest row of TICKS, and the description of the run in it.

        Raises LogError: the log exists, cannot be written, or the recorder does not start.
        """
        file = Path(path).absolute()
        created_ns = LOCKSTEP_EPOCH_NS if lockstep else time.time_ns()
        columns = describe(table.columns)
        buses = [can_channel] if isinstance(can_channel, str) else [*can_channel]
        setup = {
            "path": str(file),
            "ring_ticks": ring_ticks,
            "created_ns": created_ns,
            "scene": scene,
            "live": live,
            "mirror": mirror and (mirror[0], {**mirror[1], "version": product_version(), "columns": columns}),
            "attachments": [(CONFIGURATION, configuration.encode()), *attachments],
            "environment": environment() | (scheduling() if lockstep else {}),
            "identity": {
                **_texts(metadata or {}),
                "topic": table.topic,
                "columns": columns,
                "epoch_ns": str(created_ns if lockstep else created_ns - clock.now()),
                "can_channel": buses[0],
                **({"can_channels": json.dumps(buses)} if len(buses) > 1 else {}),
                "mode": "lockstep" if lockstep else "realtime",
            },
        }
        ring = Ring.create(table.dtype, ring_ticks)
        return cls(ring, _start(ring, setup), file, lockstep=lockstep)

    @property
    def alive(self) -> bool:
        """True while the recorder process runs."""
        return self._end.alive

    @property
    def trouble(self) -> str:
        """Reason why the recorder ended early; empty while it runs and after `close`."""
        return "" if self.alive or self._summary is not None else self._error(self._last_words(0.0))

    def tick(
        self,
        row: Rows | np.void,
        received: Rows | Sequence[Received],
        sent: Rows | Sequence[Frame],
        operator: Sequence[int] = (),
        setpoints: Sequence[SetPoint] = (),
        orders: Sequence[Order] = (),
    ) -> None:
        """Record one tick: row, frames consumed and sent in order, commands, set-points, motion commands.

        Frames as arrays (n,) of FRAME hold kind, time and bus. In lockstep, raises LogError if one tick has
        more frames than the ring, RecorderEndedError if the recorder has ended.
        """
        if not isinstance(received, np.ndarray):
            received = received_array(received)
        if not isinstance(sent, np.ndarray):
            sent = sent_at(int(row["t_ns"]), sent_array(sent))
        data = received.tobytes() + sent.tobytes()
        if operator or setpoints or orders:
            now = int(row["t_ns"])
            bare, poses = [(each, ()) for each in operator], [(_SETPOINT, each) for each in setpoints]
            for command, numbers in (*bare, *poses, *orders):
                content = pack_numbers(numbers)
                data += frame_bytes(now, command, OPERATOR, len(content), 0, content)
        count, ring = len(data) // FRAME.itemsize, self._ring
        if not self._has_room(count):
            self._drop(1)
            return
        place = self.ticks % ring.capacity
        ring.rows[place] = row
        ring.put(self._items, data)
        ring.ends[place] = self._items + count
        self._publish(1, count)

    def ticks_of_items(self, rows: Rows, items: Rows, ends: Ints) -> None:
        """Record ticks without commands; ends (n,): number of frames in `items` to the end of each tick."""
        ring, count = self._ring, len(rows)
        if count > 1 and (2 * count > ring.capacity or 2 * len(items) > ring.item_capacity):
            half = count // 2
            middle = int(ends[half - 1])
            self.ticks_of_items(rows[:half], items[:middle], ends[:half])
            self.ticks_of_items(rows[half:], items[middle:], ends[half:] - middle)
        elif self._has_room(len(items), count):
            ring.put_rows(self.ticks, rows, ends + self._items)
            ring.put(self._items, items.tobytes())
            self._publish(count, len(items))
        else:
            self._drop(count)

    def _publish(self, ticks: int, items: int) -> None:
        """Make ticks written to the ring, with their items, visible to the recorder process."""
        self._items += items
        fence()
        self.ticks += ticks
        self._counters[WRITTEN] = self.ticks

    def _drop(self, ticks: int) -> None:
        self.dropped += ticks
        self._counters[DROPPED] = self.dropped

    def event(self, t_ns: int, level: str, text: str) -> None:
        """Record a text of `level` debug, info, warning or error at t_ns, before the next tick."""
        data = text.encode(errors="replace")  # it may contain a file name that is not UTF-8
        pieces = [data[i : i + MAX_DATA] for i in range(0, len(data), MAX_DATA)] or [b""]
        if not self._has_room(len(pieces)):
            return
        for left, piece in zip(range(len(pieces) - 1, -1, -1), pieces, strict=True):
            self._ring.put(self._items, frame_bytes(t_ns, left, EVENT, len(piece), LEVELS[level], piece))
            self._items += 1
        fence()
        self._counters[EVENTS] = self._items

    def close(self, summary: Mapping[str, object] | None = None, *, timeout_s: float = 60.0) -> LogSummary:
        """Wait until the recorder has written all ticks, close the log; `summary` goes into its metadata.

        A dead recorder raises no error here: the result reports it.
        """
        if self._summary is None:
            with contextlib.suppress(OSError):
                self._end.send(_texts(summary or {}))
            reply = self._last_words(timeout_s)
            self._end.finish()
            self._ring.close_fd()
            self._summary = self._summarise(reply)
        return self._summary

    def _summarise(self, reply: Mapping[str, Any]) -> LogSummary:
        ticks = reply.get("ticks", self._counters[READ])
        lost, error = self.ticks - ticks, self._error(reply)
        return LogSummary(
            path=self.path,
            ticks=ticks,
            messages=reply.get("messages", 0),
            dropped=self.dropped,
            lost=lost,
            size_bytes=reply.get("size_bytes", self.path.stat().st_size if self.path.exists() else 0),
            recorder_cpu_s=reply.get("recorder_cpu_s", 0.0),
            complete=not error and not self.dropped and not lost,
            error=error,
            gave_up="error" in reply,
        )

    def _last_words(self, timeout_s: float) -> Mapping[str, Any]:
        """Final reply of the recorder process, waited for up to `timeout_s` and read once."""
        if self._reply is None:
            self._reply = self._end.answer(timeout_s)
        return self._reply

    def _error(self, reply: Mapping[str, Any]) -> str:
        died = "the recorder died; recover the log with `hil replay --salvage`"
        return str(reply.get("error", "" if "ticks" in reply else died))

    def _has_room(self, count: int, rows: int = 1) -> bool:
        """True if `rows` rows and `count` items fit into the ring; in lockstep, wait until they do."""
        ring, counters = self._ring, self._counters
        while (
            self.ticks + rows - counters[READ] > ring.capacity
            or self._items + count - counters[READ_ITEMS] > ring.item_capacity
        ):
            if not self._lockstep:
                return False
            if not self.alive:
                raise RecorderEndedError(f"{self.path}: {self.trouble}")
            if count > ring.item_capacity:
                raise LogError(f"one tick has {count} frames, but the ring holds {ring.item_capacity}")
            time.sleep(0.0002)
        return True

    def __exit__(self, *error: object) -> None:
        self.close()


def _start(ring: Ring, setup: Mapping[str, Any]) -> RecorderEnd:
    """Start the recorder process and wait until its log is open. Raises LogError."""
    end = RecorderEnd(ring)
    try:
        from hil.record.packer import pack  # noqa: PLC0415 - Numba; the process starts meanwhile

        end.send({**setup, "packer": pack.machine_code})
        reply = end.answer(_START_S)
    except OSError:
        reply = end.answer(1.0)
    except BaseException:  # an interrupt: the recorder closes its file and ends
        end.finish()
        raise
    if "ready" not in reply:
        if end.process is not None:
            end.process.kill()
        end.finish()
        raise LogError(str(reply.get("error", f"{setup['path']}: the recorder process did not start")))
    return end


def _texts(values: Mapping[str, object]) -> dict[str, str]:
    texts = {key: value if isinstance(value, str) else json.dumps(value) for key, value in values.items()}
    return {key: text.encode(errors="replace").decode() for key, text in texts.items()}
