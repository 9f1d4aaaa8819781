"""The live status line of a run, drawn from the rows that the recorder drains."""

import time
from typing import Any, TextIO

import numpy as np

from drivers.arrays import Rows
from drivers.signals import Mode, Warn
from drivers.terminal_row import rewriting

TERMINAL_S = 0.2
"""Time between two lines on a terminal, which overwrite one another."""
PLAIN_S = 5.0
"""Time between two lines elsewhere."""


class LiveView:
    """Rewrites one line on a terminal, or adds one every few seconds elsewhere.

    Mutable state: when the next line is due, and what has happened since the last one.
    """

    def __init__(self, out: TextIO, reference_s: float | None) -> None:
        """Write to `out`; `reference_s` is the length of the reference, None if it has no end."""
        self._out = out
        self._reference_s = reference_s
        self._terminal = out.isatty()
        self._due = time.monotonic()
        self._stale = self._skipped = 0
        self._late_us = 0.0

    def show(self, rows: Rows) -> None:
        """Take a batch of rows of dtype ROW into account, and draw if it is time."""
        if not len(rows):
            return
        self._stale += int(np.count_nonzero(rows["warnings"] & Warn.STALE))
        self._skipped += int(rows["skipped"].sum())
        self._late_us = max(self._late_us, float(rows["lateness_ns"].max()) / 1e3)
        now = time.monotonic()
        if now < self._due:
            return
        self._due = now + (TERMINAL_S if self._terminal else PLAIN_S)
        self._draw(self.line(rows[-1]))
        self._late_us = 0.0

    def line(self, row: Any) -> str:
        """Return the status as of one row."""
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

    def end(self) -> None:
        """Leave the line."""
        if self._terminal:
            self._draw("")

    def _draw(self, text: str) -> None:
        try:
            self._out.write(rewriting(text, self._out) if self._terminal else f"{text}\n")
            self._out.flush()
        except OSError:
            self._due = float("inf")
