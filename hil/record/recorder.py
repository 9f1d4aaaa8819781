"""Recorder process: writes the ticks in the ring to the log until its producer closes or dies.

Signals do not end it. Command: `python -m hil.record.recorder RING_FD LINK_FD PRODUCER_PID`. It reads the
set-up, then the summary, from the link, and answers there (`hil.record.child` is the other end).
"""

from __future__ import annotations

import contextlib
import errno
import math
import os
import signal
import sys
import time
from collections.abc import Callable, Mapping
from itertools import pairwise
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any

import numpy as np
from mcap.records import Channel, Schema

from drivers.arrays import Rows
from drivers.errors import LogError
from drivers.signals import Mode
from hil.record.child import receive
from hil.record.encode import TICK, Encoder, Messages
from hil.record.mcap_file import CHUNK_SIZE, McapFile
from hil.record.mirror import Mirror
from hil.record.publish import LiveSocket, LiveView, Publisher
from hil.record.recording import Live
from hil.record.ring import DROPPED, Ring
from hil.record.row import Run, Table
from hil.record.schema import (
    CLEAN,
    DISK_FULL,
    ENVIRONMENT,
    IDENTITY,
    LIBRARY,
    PEAK_ERROR,
    PRODUCER_DIED,
    SPAN,
    SUMMARY,
)

FLUSH_S = 0.1
"""Time between two chunks in real time, s; if all processes are killed, at most twice this time is lost."""
_POLL_S = 0.02
"""Polling period for the newest row in real time."""
_LOCKSTEP_POLL_S = 0.004
_SYNC_S = 1.0
_MOST_TICKS = 2048
_FULL = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG})
"""Disk full, quota exceeded, or file size limit of the process (`ulimit -f`) reached."""
_MEDIA = {".yaml": "application/yaml", ".json": "application/json", ".dbc": "text/plain", ".csv": "text/csv"}


class Recorder:
    """Writer of one log. State: read position in the ring, the file, figures of the run, the live outputs."""

    def __init__(self, ring: Ring, run: Run, setup: Mapping[str, Any]) -> None:
        """Open the log; `setup` comes from `hil.record.recording.Recording.start`."""
        self._ring = ring
        self._lockstep = run.lockstep
        self._encoder = Encoder(
            Table(run.topic, run.columns),
            epoch_ns=run.epoch_ns,
            can_channels=run.can_channels,
            scene=setup["scene"],
            packer=setup.get("packer"),
        )
        # fixed batches make the whole data section reproducible, not only its messages
        self.batch = max(16, CHUNK_SIZE // (ring.rows.dtype.itemsize + 1024))
        self.batch = min(self.batch, ring.capacity // 2)
        live: Live = setup["live"]
        self._live = LiveView(sys.stderr, live.reference_s, lockstep=run.lockstep) if live.status else None
        where = live.websocket
        self.socket = LiveSocket(where[0], where[1], self._encoder.channels) if where else None
        version = setup["environment"].get("version", "unknown")
        self.file = McapFile(Path(setup["path"]), f"{LIBRARY}/{version}")
        try:
            self._open(setup)
        except (OSError, ValueError):
            self.file.discard()  # it has no tick
            raise
        self._first_ns: int | None = None
        self._figures: dict[str, float] = {}
        self._publisher = _publisher(ring, setup["mirror"])  # last: only a run that has started is shown

    def _open(self, setup: Mapping[str, Any]) -> None:
        self.file.add_metadata(IDENTITY, setup["identity"])
        self.file.add_metadata(ENVIRONMENT, setup["environment"])
        for name, data in setup["attachments"]:
            media_type = _MEDIA.get(Path(name).suffix, "application/octet-stream")
            self.file.add_attachment(name, data, setup["created_ns"], media_type)
        for channel_id, (topic, schema, metadata) in self._encoder.channels.items():
            self.file.add(Schema(channel_id, schema.descriptors, "protobuf", schema.name))
            self.file.add(Channel(channel_id, topic, "protobuf", metadata, channel_id))
        self.file.sync()

    def run(self, control: Control) -> None:
        """Move ticks from the ring to the log until the producer closes or dies; end the live outputs."""
        flushed = synced = due = time.monotonic()
        with contextlib.ExitStack() as live:
            for output in (self._publisher, self._live):
                if output is not None:
                    live.callback(output.close)
            while not control.ended(_LOCKSTEP_POLL_S if self._lockstep else max(0.0, due - time.monotonic())):
                now = time.monotonic()
                due = max(due + _POLL_S, now)
                if self._publisher is not None:
                    self._publisher.publish(self.file.position)
                if self._lockstep:
                    while self._ring.ready(self.batch):
                        self._drain(self.batch)
                elif now - flushed >= FLUSH_S - _POLL_S / 2 or self._ring.ready(self._ring.capacity // 4):
                    flushed = now
                    self._drain(_MOST_TICKS)
                    if now - synced >= _SYNC_S:
                        synced = now
                        self.file.sync()
            while self._drain(self.batch if self._lockstep else _MOST_TICKS):
                pass

    def close(self, summary: Mapping[str, str] | None) -> dict[str, object]:
        """Write the summary, close the log and return the final reply; `summary` None: the producer died."""
        counts = self._counts(CLEAN if summary is not None else PRODUCER_DIED)
        self.file.add_metadata(SUMMARY, {**(summary or {}), **self._figures, **counts})
        self.file.finish()
        return self._final_reply(counts)

    def close_full(self, error: OSError) -> dict[str, object]:
        """Close the log on a full disk with the content that fits, and return the final reply."""
        self.file.finish_within(SUMMARY, lambda: self._figures | self._counts(DISK_FULL))
        return {
            **self._final_reply(self._counts(DISK_FULL)),
            "error": f"{DISK_FULL}: {error.strerror}; the log is closed and holds the first "
            f"{self.file.messages_of(TICK)} ticks, {self.file.position} bytes: {self.file.path}",
        }

    def _final_reply(self, counts: Mapping[str, object]) -> dict[str, object]:
        """Final reply to the producer: counts, size and processor time of a closed log."""
        times = os.times()
        return {**counts, "size_bytes": self.file.position, "recorder_cpu_s": times.user + times.system}

    def _counts(self, closed: str) -> dict[str, object]:
        return {
            "closed": closed,
            "ticks": self.file.messages_of(TICK),
            "messages": self.file.messages,
            "dropped": self._ring.counters[DROPPED],
        }

    def _drain(self, limit: int) -> bool:
        """Move up to `limit` ticks from the ring to the log; False if the ring was empty."""
        batch = self._ring.take(limit)
        if not len(batch.rows) and not len(batch.items):
            return False
        messages = self._encoder.encode(batch)
        self._write(messages)
        self._measure(batch.rows)
        if self._live is not None:
            self._live.show(batch.rows)
        if self._publisher is not None:
            self._publisher.drained(batch)
        self._ring.release(batch)
        if self.socket is not None:
            self.socket.publish(messages)
        return True

    def _measure(self, rows: Rows) -> None:
        """Add rows to the figures of the run in the summary of its log."""
        if not len(rows):
            return
        if self._first_ns is None:
            self._first_ns = int(rows["t_ns"][0])
        self._figures[SPAN] = 1e-9 * (int(rows["t_ns"][-1]) - self._first_ns)
        tracking = rows[rows["mode"] == Mode.TRACKING] if "q_d" in (rows.dtype.names or ()) else rows[:0]
        if len(tracking):
            error_mm = 1e3 * float(np.abs(tracking["q_d"] - tracking["q"]).max())
            self._figures[PEAK_ERROR] = max(error_mm, self._figures.get(PEAK_ERROR, 0.0))

    def _write(self, messages: Messages) -> None:
        """Write messages as compressed chunks of about CHUNK_SIZE bytes that begin and end between ticks."""
        start, tick, data = messages.start, messages.tick, messages.data.data
        chunks = math.ceil(int(start[-1]) / CHUNK_SIZE)
        tick_starts = np.append(0, np.flatnonzero(tick[1:] != tick[:-1]) + 1)
        wanted = np.arange(chunks) * (start[-1] / chunks)
        inner = tick_starts[np.minimum(np.searchsorted(start[tick_starts], wanted), len(tick_starts) - 1)]
        cuts = sorted({*inner.tolist(), len(tick)})
        for first, last in pairwise(cuts):
            self.file.add_chunk(
                data[start[first] : start[last]],
                messages.channel[first:last],
                messages.log_time[first:last],
                start[first:last] - start[first],
            )


def _publisher(ring: Ring, mirror: tuple[Path, Mapping[str, object]] | None) -> Publisher | None:
    """Writer of the mirror file for `hil watch`; None without a mirror, or if it cannot be created."""
    if mirror is None:
        return None
    try:
        return Publisher(ring, Mirror(*mirror))
    except OSError as error:
        print(f"hil: `hil watch` cannot see this run: {mirror[0]}: {error.strerror}", file=sys.stderr)
        return None


class Control:
    """Waits for the end of the producer: its summary on the link, or its death. State: the summary."""

    def __init__(self, link: Connection[Any, Any], producer: int | None) -> None:
        """producer: its process; None for the process of the recorder itself."""
        self._link = link
        self.summary: dict[str, str] | None = None
        self._watched: list[Any] = [link]
        self._orphan = producer is not None and os.getppid() != producer
        if producer is not None:  # a child that outlives the producer could hold the link open
            with contextlib.suppress(OSError):
                self._watched.append(os.pidfd_open(producer))

    def ended(self, timeout_s: float) -> bool:
        """Wait up to `timeout_s`; True if the producer has closed the recording or died."""
        ready = wait(self._watched, timeout_s)
        if self._link in ready:
            self.summary = receive(self._link)
        return self._orphan or bool(ready)


def _recorded(recorder: Recorder, control: Control) -> dict[str, object]:
    """Record until the producer closes or dies, or the disk is full; return the final reply."""
    try:
        recorder.run(control)
        return recorder.close(control.summary)
    except OSError as error:
        if error.errno not in _FULL or not recorder.file.messages:
            raise
        return recorder.close_full(error)


def main(arguments: list[str]) -> int:
    """Run the recorder process; return its exit code: 0 for a closed log, 1 after an error."""
    for name in ("SIGINT", "SIGTERM", "SIGHUP"):
        signal.signal(getattr(signal, name), signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_SETMASK, ())
    ring_fd, link_fd, producer = map(int, arguments)

    def mapped(table: Table, ticks: int) -> Ring:
        ring = Ring(ring_fd, table.dtype, ticks)
        ring.close_fd()
        return ring

    return record(Connection(link_fd), mapped, producer)


def record(
    link: Connection[Any, Any], mapped: Callable[[Table, int], Ring], producer: int | None = None
) -> int:
    """Record one log; return the exit code. `mapped` gives the ring; `producer` as for `Control`."""
    setup, file = receive(link), None
    if setup is None:
        return 1
    if producer is None:
        setup["packer"] = None  # that of this process

    def say(message: Mapping[str, object]) -> None:
        with contextlib.suppress(OSError):  # the producer has ended
            link.send(message)

    try:
        run = Run.of(setup["identity"])
        recorder = Recorder(mapped(Table(run.topic, run.columns), setup["ring_ticks"]), run, setup)
        file = recorder.file
        control = Control(link, producer)
        say({"ready": True})
        say(_recorded(recorder, control))
        if recorder.socket is not None and not recorder.socket.close():
            os._exit(0)  # the log is closed; a client that does not read would block the exit
    except FileExistsError as error:
        trouble = f"{error.filename} exists and is never overwritten: choose another name for the log"
    except OSError as error:
        written = f" after {file.position} bytes" if file else ""
        why = f"{DISK_FULL}: {error.strerror}" if error.errno in _FULL else error.strerror
        if file is not None and not file.messages:
            file.discard()
        trouble = f"the log cannot be written{written}: {why}: {setup['path']}"
    except (LogError, ValueError) as error:
        trouble = f"{setup['path']}: {error}"
    else:
        return 0
    say({"error": trouble})
    return 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
