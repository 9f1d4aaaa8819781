"""Server-sent events for viewers of the live page, from the shared memory of the present run."""

import json
import time
from pathlib import Path
from typing import Any

from drivers.errors import LogError
from hil.app.watch.state import curves, state
from hil.record.mirror import MirrorReader

PERIOD_S = 0.01
"""Shortest period, s, of reading the shared memory, which the recorder fills every 20 ms."""
FOLLOW_S = 0.5
"""Period of looking for a new run."""
PAST_S = 0.5
"""Longest age of the curves of the last minute that a new viewer gets."""
REPEAT_S = 0.25
"""Period of repeating an unchanged state, whose age grows."""


class Feed:
    """Follows the runs on one bus, and turns their data into server-sent events.

    Mutable state: the shared memory of the run, the events (new objects when they change), and their times.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._reader: MirrorReader | None = None
        self._looked = self._followed = self._made = float("-inf")
        self._number = 0
        self._past = float("-inf"), b""
        self._events: list[dict[str, Any]] = []
        self.said: dict[str, Any] | None = None
        """Status of the controller, if it is requested."""
        self.about = event("about", {"trouble": "nothing runs on this bus yet"})
        self.events = event("events", [])
        self.state = b""

    def look(self, now: float) -> None:
        """Read new data of the run and renew the events. now: CLOCK_MONOTONIC, s."""
        if now - self._looked < PERIOD_S:
            return
        self._looked = now
        if now - self._followed >= FOLLOW_S:
            self._followed = now
            self._follow()
        reader = self._reader
        if reader is None or (reader.newest == self._number and now - self._made < REPEAT_S):
            return
        piece = reader.read()
        if piece is None:
            return
        try:
            if piece.events != self._events:
                self._events = piece.events
                begin_s = 1e-9 * piece.row["t_ns"] - piece.row["tick"] / reader.about["rate_Hz"]
                self.events = event("events", [_shown_event(each, begin_s) for each in piece.events])
            shown = state(piece, reader.about, time.monotonic_ns())
        except (AttributeError, LookupError, TypeError, ValueError):
            self._trouble(f"{self._path} comes from another version of hil: use the version of the run")
            self._number, self._made = reader.newest, now
            return
        self.state = event("state", shown | {"ended": piece.ended, "said": self.said})
        self._number, self._made = piece.number, now

    def past(self) -> bytes:
        """Event with the curves of the last minute, for a new viewer; empty without a run."""
        reader, now = self._reader, time.monotonic()
        if reader is not None and now - self._past[0] > PAST_S:
            self._past = now, event("past", curves(reader.past(), reader.about))
        return self._past[1]

    def _follow(self) -> None:
        try:
            if self._reader is not None and self._reader.inode == self._path.stat().st_ino:
                return
            reader = MirrorReader(self._path)
        except FileNotFoundError:
            return  # the last data stay
        except (LogError, OSError, LookupError, TypeError, ValueError) as error:
            self._trouble(str(error))
            return
        self._reader, self._number, self._events = reader, 0, []
        self._past = float("-inf"), b""
        self.state, self.events = b"", event("events", [])
        about = {name: value for name, value in reader.about.items() if name != "columns"}
        self.about = event("about", about)

    def _trouble(self, text: str) -> None:
        trouble = event("about", {"trouble": text})
        if trouble != self.about:
            self.about = trouble


def event(name: str, data: Any) -> bytes:
    """Server-sent event of type `name` with JSON data, as bytes."""
    text = json.dumps(data, allow_nan=False, separators=(",", ":"))
    return f"event: {name}\ndata: {text}\n\n".encode()


def _shown_event(found: dict[str, Any], begin_s: float) -> dict[str, Any]:
    """Event of the log for the page, at its time since tick 0, without the values behind a finding's text."""
    text, _, last = found["text"].rpartition("\n")
    shown = text if text and last.startswith("{") else found["text"]
    return {"t": round(1e-9 * found["t_ns"] - begin_s, 3), "level": found["level"], "text": shown}
