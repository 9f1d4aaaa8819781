"""Live outputs of the recorder: a status line, a mirror of the newest row, messages on a websocket.

These outputs copy from the ring and do not change how it is emptied. The Foxglove SDK sends in its own
threads; a client that reads too slowly loses the oldest messages.
"""

import json
import threading
import time
from collections import deque
from collections.abc import Mapping
from typing import Any, TextIO

import numpy as np

from drivers.arrays import Rows
from drivers.errors import LogError
from drivers.signals import Mode, Warn
from drivers.terminal_row import rewriting
from hil.record.encode import Messages, event_text
from hil.record.layout import RECORD_HEADER
from hil.record.mirror import FIGURES, Mirror
from hil.record.ring import DROPPED, EVENT, READ, Batch, Ring
from hil.record.schema import LEVEL_NAMES, LIBRARY, Schema

TERMINAL_S = 0.2
"""Time between two lines on a terminal, where each overwrites the one before."""
PLAIN_S = 5.0
"""Time between two lines of output that is not a terminal, s."""
LOCKSTEP_S = 20.0
"""Time between two lines for a run in simulated time without a terminal, and before its first line, s."""
LAST_EVENTS = 40
LONGEST_EVENT = 600
"""Most characters shown of one event; the log has all of them."""
_WINDOW_NS = 1_000_000_000
_PEAKS = {"late_ns": "lateness_ns", "compute_ns": "compute_ns"}


class Publisher:
    """Copies the newest row, figures and events of a run from the ring to the mirror file for `hil watch`.

    Mutable state: the number of rows counted, the figures, the last events.
    """

    def __init__(self, ring: Ring, mirror: Mirror) -> None:
        self._ring, self._mirror = ring, mirror
        self._counted = 0
        self._figures: Rows = np.zeros((), FIGURES)
        self._figures["capacity"] = ring.capacity
        self._events: deque[dict[str, Any]] = deque(maxlen=LAST_EVENTS)
        self._text = b"[]"
        self._event_count = 0
        self._window_ns = 0
        self._before, self._present = dict.fromkeys(_PEAKS, 0), dict.fromkeys(_PEAKS, 0)

    def publish(self, log_bytes: int) -> None:
        """Write the newest row in the ring to the mirror; log_bytes: size of the log so far."""
        rows = self._ring.since(self._counted)
        if len(rows):
            self._count(rows)
        if not self._counted:
            return
        figures, counters = self._figures, self._ring.counters
        figures["dropped"], figures["log_bytes"] = counters[DROPPED], log_bytes
        figures["waiting"] = self._counted - counters[READ]
        self._mirror.write(self._ring.rows[(self._counted - 1) % self._ring.capacity], figures, self._text)

    def drained(self, batch: Batch) -> None:
        """Count the rows and keep the events of a batch, before the ring releases the batch."""
        first = self._ring.counters[READ]
        self._count(batch.rows[max(0, self._counted - first) :])
        found = np.flatnonzero((batch.items["kind"] == EVENT) & (batch.items["id"] == 0)).tolist()
        for i in found:
            t_ns, level, text = batch.items[i]["t_ns"], batch.items[i]["flags"], event_text(batch.items, i)
            self._event_count += 1
            self._events.append(
                {
                    "number": self._event_count,
                    "t_ns": int(t_ns),
                    "level": LEVEL_NAMES[int(level)],
                    "text": text if len(text) <= LONGEST_EVENT else f"{text[:LONGEST_EVENT]} …",
                }
            )
        if found:
            self._text = json.dumps(list(self._events)).encode()

    def close(self) -> None:
        """Write the last events to the mirror and mark the run as ended."""
        self.publish(int(self._figures["log_bytes"]))
        self._mirror.close()

    def _count(self, rows: Rows) -> None:
        if not len(rows):
            return
        figures, now = self._figures, time.monotonic_ns()
        self._counted += len(rows)
        figures["seen_ns"], figures["ticks"] = now, self._counted
        figures["stale"] += np.count_nonzero(rows["warnings"] & Warn.STALE)
        figures["skipped"] += rows["skipped"].sum()
        if now - self._window_ns > _WINDOW_NS:
            self._window_ns = now
            self._before, self._present = self._present, dict.fromkeys(_PEAKS, 0)
        for name, column in _PEAKS.items():
            self._present[name] = max(self._present[name], int(rows[column].max()))
            figures[name] = max(self._before[name], self._present[name])


class LiveView:
    """Status line of a run: rewrites it on a terminal, or adds a line every few seconds elsewhere.

    Mutable state: the time of the next line, the counts so far, the lateness since the last line.
    """

    def __init__(self, out: TextIO, reference_s: float | None, *, lockstep: bool = False) -> None:
        """Write to `out`; `reference_s` is the length of the reference, None without an end.

        lockstep: without a terminal a line every LOCKSTEP_S, as most simulations are over before.
        """
        self._out = out
        self._reference_s = reference_s
        self._terminal = out.isatty()
        self._every_s = TERMINAL_S if self._terminal else LOCKSTEP_S if lockstep else PLAIN_S
        self._due = time.monotonic() + (LOCKSTEP_S if lockstep and not self._terminal else 0.0)
        self._stale = self._skipped = 0
        self._late_us = 0.0

    def show(self, rows: Rows) -> None:
        """Count a batch of rows of dtype ROW, and draw the status line if its interval is over."""
        if not len(rows):
            return
        self._stale += int(np.count_nonzero(rows["warnings"] & Warn.STALE))
        self._skipped += int(rows["skipped"].sum())
        self._late_us = max(self._late_us, float(rows["lateness_ns"].max()) / 1e3)
        now = time.monotonic()
        if now < self._due:
            return
        self._due = now + self._every_s
        self._draw(self.line(rows[-1]))
        self._late_us = 0.0

    def line(self, row: Any) -> str:
        """Text of the status line for one row: mode, progress, leg error, force, lateness, lost ticks."""
        mode = Mode(int(row["mode"]))
        parts = [f"{mode.name.lower():9s}"]
        if mode is Mode.TRACKING:
            t = float(row["reference_time_s"])
            if self._reference_s:
                done = min(1.0, t / self._reference_s)
                parts.append(f"{'#' * round(20 * done):20s}| {t:5.1f} of {self._reference_s:g} s")
            else:
                parts.append(f"{t:6.1f} s")
            parts.append(f"leg error {np.abs(row['q_d'] - row['q']).max() * 1e3:6.3f} mm")
        parts.append(f"force {np.abs(row['tau']).max():7.1f} N")
        parts.append(f"late {self._late_us:4.0f} us")
        parts.append(f"stale {self._stale}, skipped {self._skipped}")
        return "  ".join(parts)

    def close(self) -> None:
        """Clear the status line on a terminal."""
        if self._terminal:
            self._draw("")

    def _draw(self, text: str) -> None:
        try:
            self._out.write(rewriting(text, self._out) if self._terminal else f"{text}\n")
            self._out.flush()
        except OSError:
            self._due = float("inf")


BACKLOG = 8192
"""Most messages that wait for one client; a batch of 0.1 s at 1 kHz has about 1,600."""
GOODBYE_S = 1.0
"""Time limit for the clients to read the rest at the end of a run."""


class LiveSocket:
    """Websocket server that sends a log's messages to viewers. State: the server; None after its end.

    Raises LogError: foxglove-sdk is not installed, or the server cannot listen at host and port.
    """

    def __init__(
        self, host: str, port: int, channels: Mapping[int, tuple[str, Schema, dict[str, str]]]
    ) -> None:
        try:
            import foxglove  # noqa: PLC0415 - an extra
        except ImportError as error:
            raise LogError(
                f"recording.websocket: needs foxglove-sdk, which is not installed ({error}): "
                'pip install "hexapod-hil[viewers]", or leave recording.websocket out'
            ) from error
        foxglove.set_log_level("CRITICAL")  # mistakes of clients do not concern the operator
        self._context = foxglove.Context()  # the server has only a weak reference to it
        try:
            self._server: Any = foxglove.start_server(
                name=LIBRARY, host=host, port=port, context=self._context, message_backlog_size=BACKLOG
            )
        except RuntimeError as error:
            raise LogError(
                f"recording.websocket: {host}:{port}: {error}: set another port, or free this one"
            ) from error
        self._channels = {
            number: foxglove.Channel(
                topic,
                schema=foxglove.Schema(name=schema.name, encoding="protobuf", data=schema.descriptors),
                message_encoding="protobuf",
                metadata=metadata,
                context=self._context,
            )
            for number, (topic, schema, metadata) in channels.items()
        }

    def publish(self, messages: Messages) -> None:
        """Send a batch of messages to the subscribed viewers. Never raises, never waits for a viewer."""
        if self._server is None:
            return
        subscribed = {number: channel for number, channel in self._channels.items() if channel.has_sinks()}
        if not subscribed:
            return
        try:
            for number, log_time, record in zip(
                messages.channel.tolist(), messages.log_time.tolist(), messages.records(), strict=True
            ):
                if number in subscribed:
                    subscribed[number].log(bytes(record[RECORD_HEADER:]), log_time=log_time)
        except RuntimeError:  # the log continues without viewers
            self.close()

    def close(self) -> bool:
        """Send the waiting messages and close; False if a viewer did not read them within GOODBYE_S."""
        if self._server is None:
            return True
        goodbye = threading.Thread(target=self._server.stop, daemon=True)
        self._server = None
        goodbye.start()
        goodbye.join(GOODBYE_S)
        return not goodbye.is_alive()
