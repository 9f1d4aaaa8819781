"""What is sent to the watchers: from the mirror of the present run to server-sent events."""

import json
import time
from pathlib import Path
from typing import Any

from drivers.errors import LogError
from hil.app.watch.state import state
from hil.record.mirror import MirrorReader, foreign

LOOK_S = 0.5
"""Between two looks for a run that has followed."""
REPEAT_S = 0.25
"""A state that does not change is repeated so often: its age grows."""


class Feed:
    """Follows the runs on one bus, each by its own mirror.

    Mutable state: the mirror that is read, the last of what was made of it, and when.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._reader: MirrorReader | None = None
        self._foreign = False
        """What is there cannot be shown. It stays mapped, so that no other file gets its inode."""
        self._looked = self._made = float("-inf")
        self._number = 0
        self._events: list[dict[str, Any]] = []
        self._trouble = ""
        self.said: dict[str, Any] | None = None
        """What the controller says of itself, where it is asked."""
        self.run = 0
        """Counts the runs that were found, and what else changes the description."""
        self.about = event("about", {"trouble": "nothing runs on this bus yet"})
        self.heard = 0
        """Counts the changes of the events."""
        self.events = event("events", [])
        self.state = b""

    def look(self, now: float) -> bool:
        """Take in what is new; return whether `state` is. now: CLOCK_MONOTONIC, s."""
        if now - self._looked >= LOOK_S:
            self._looked = now
            self._follow()
        reader = self._reader
        if reader is None or self._foreign or (reader.newest == self._number and now - self._made < REPEAT_S):
            return False
        try:
            piece = reader.read()
            if piece is None:
                return False
            shown = state(piece, reader.about, time.monotonic_ns())
            told = [_told(each) for each in piece.events] if piece.events != self._events else None
            self.state = event("state", shown | {"run": self.run, "ended": reader.ended, "said": self.said})
            if told is not None:
                self.events = event("events", told)
        except (AttributeError, LookupError, TypeError, ValueError):  # other names, shapes or sizes
            self._foreign, self.state = True, b""
            self._complain(str(foreign(self._path)))
            return False
        self._number, self._made = piece.number, now
        if told is not None:
            self._events = piece.events
            self.heard += 1
        return True

    def _follow(self) -> None:
        """Attach to the run that is there now, if it is another one."""
        try:
            inode = self._path.stat().st_ino
            if self._reader is not None and self._reader.inode == inode:
                return
            reader = MirrorReader(self._path)
        except FileNotFoundError:
            return  # what was shown last stays
        except (LogError, OSError) as error:
            self._complain(str(error))
            return
        self._reader, self._number, self._events, self._trouble = reader, 0, [], ""
        self._foreign = False
        self.run += 1
        self.heard += 1
        self.state, self.events = b"", event("events", [])
        about = {name: value for name, value in reader.about.items() if name != "columns"}
        self.about = event("about", {**about, "run": self.run})

    def _complain(self, trouble: str) -> None:
        if trouble != self._trouble:
            self._trouble = trouble
            self.run += 1
            self.about = event("about", {"trouble": trouble, "run": self.run})


def event(name: str, data: Any) -> bytes:
    """Return a server-sent event."""
    text = json.dumps(data, allow_nan=False, separators=(",", ":"))
    return f"event: {name}\ndata: {text}\n\n".encode()


def _told(found: dict[str, Any]) -> dict[str, Any]:
    """Return an event for the page: the values behind the text of a finding are not shown."""
    text, _, last = found["text"].rpartition("\n")
    shown = text if text and last.startswith("{") else found["text"]
    return {"t": round(found["t_ns"] * 1e-9, 3), "level": found["level"], "text": shown}
