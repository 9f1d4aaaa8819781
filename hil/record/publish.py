"""What the recorder shows of a run while it runs: the newest row, counts, the last events.

It looks at the ring and copies; the ring is drained as it would be without it.
"""

import json
import time
from collections import deque
from typing import Any

import numpy as np

from drivers.arrays import Rows
from drivers.signals import Warn
from hil.record.encode import event_text
from hil.record.mirror import FIGURES, Mirror
from hil.record.ring import DROPPED, EVENT, READ, Batch, Ring
from hil.record.schema import LEVEL_NAMES

LAST_EVENTS = 40
LONGEST_EVENT = 600
"""Characters that are shown of one; all are in the log."""
_WINDOW_NS = 1_000_000_000
_PEAKS = {"late_ns": "lateness_ns", "compute_ns": "compute_ns"}


class Publisher:
    """Fills a mirror from the ring of a run, whose rows have dtype ROW.

    Mutable state: which rows were counted, the counts, the last events.
    """

    def __init__(self, ring: Ring, mirror: Mirror) -> None:
        self._ring, self._mirror = ring, mirror
        self._counted = 0
        self._figures: Rows = np.zeros((), FIGURES)
        self._figures["capacity"] = ring.capacity
        self._events: deque[dict[str, Any]] = deque(maxlen=LAST_EVENTS)
        self._text = b"[]"
        self._heard = 0
        self._window_ns = 0
        self._before, self._present = dict.fromkeys(_PEAKS, 0), dict.fromkeys(_PEAKS, 0)

    def publish(self, log_bytes: int) -> None:
        """Show the newest row that the producer has published; log_bytes: the size of the log so far."""
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
        """Take a batch into account before its room is given back."""
        first = self._ring.counters[READ]
        self._count(batch.rows[max(0, self._counted - first) :])
        found = np.flatnonzero((batch.items["kind"] == EVENT) & (batch.items["id"] == 0)).tolist()
        for i in found:
            t_ns, level, text = batch.items[i]["t_ns"], batch.items[i]["flags"], event_text(batch.items, i)
            self._heard += 1
            self._events.append(
                {
                    "number": self._heard,
                    "t_ns": int(t_ns),
                    "level": LEVEL_NAMES[int(level)],
                    "text": text if len(text) <= LONGEST_EVENT else f"{text[:LONGEST_EVENT]} …",
                }
            )
        if found:
            self._text = json.dumps(list(self._events)).encode()

    def close(self) -> None:
        """Show the last events, and that nothing follows."""
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
